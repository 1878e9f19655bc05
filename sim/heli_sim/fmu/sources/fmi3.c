/* FMI 3.0 (https://fmi-standard.org/docs/3.0/) around a rig: model exchange and co-simulation. The types are
 * those of the standard's section 2.2, declared here so that this folder compiles by itself. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "rig.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef uint32_t Reference;
typedef void (*LogMessage)(void* environment, fmi3Status status, const char* category, const char* message);

typedef struct {
    RigState rig;
    LogMessage log;
    void* environment;
    bool co_simulation;
} Instance;

static fmi3Status refuse(Instance* instance, const char* why) {
    if (instance != NULL && instance->log != NULL) {
        instance->log(instance->environment, fmi3Error, "logStatusError", why);
    }
    return fmi3Error;
}

EXPORT const char* fmi3GetVersion(void) {
    return "3.0";
}

EXPORT fmi3Status fmi3SetDebugLogging(Instance* i, bool on, size_t n, const char* const categories[]) {
    (void)i, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

static Instance* instantiate(const char* token, void* environment, LogMessage log, bool co_simulation) {
    Instance* instance = calloc(1, sizeof *instance);
    if (instance == NULL) return NULL;
    instance->log = log;
    instance->environment = environment;
    instance->co_simulation = co_simulation;
    if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        refuse(instance, "the instantiation token is of another model description");
        free(instance);
        return NULL;
    }
    rig_reset(&instance->rig);
    return instance;
}

EXPORT Instance* fmi3InstantiateModelExchange(const char* name, const char* token, const char* resources,
                                              bool visible, bool logging, void* environment, LogMessage log) {
    (void)name, (void)resources, (void)visible, (void)logging;
    return instantiate(token, environment, log, false);
}

EXPORT Instance* fmi3InstantiateCoSimulation(const char* name, const char* token, const char* resources,
                                             bool visible, bool logging, bool event_mode, bool early_return,
                                             const Reference required[], size_t n_required,
                                             void* environment, LogMessage log, void* intermediate_update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)required, (void)n_required, (void)intermediate_update;
    return instantiate(token, environment, log, true);
}

EXPORT Instance* fmi3InstantiateScheduledExecution(const char* name, const char* token,
                                                   const char* resources, bool visible, bool logging,
                                                   void* environment, LogMessage log, void* clock_update,
                                                   void* lock, void* unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)clock_update, (void)lock, (void)unlock;
    return NULL;
}

EXPORT void fmi3FreeInstance(Instance* instance) {
    free(instance);
}

EXPORT fmi3Status fmi3EnterInitializationMode(Instance* i, bool has_tolerance, double tolerance,
                                              double start_s, bool has_stop, double stop_s) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_s;
    rig_begin(&i->rig, start_s);
    return fmi3OK;
}

EXPORT fmi3Status fmi3ExitInitializationMode(Instance* i) {
    rig_measure(&i->rig);
    return fmi3OK;
}

EXPORT fmi3Status fmi3EnterEventMode(Instance* i) {
    (void)i;
    return fmi3OK;
}

EXPORT fmi3Status fmi3Terminate(Instance* i) {
    (void)i;
    return fmi3OK;
}

EXPORT fmi3Status fmi3Reset(Instance* i) {
    rig_reset(&i->rig);
    return fmi3OK;
}

/* Value references, as description.py gives them out. */
enum {
    TIME = 0,
    INPUTS = 1,
    OUTPUTS = 3,
    INDICATORS = 6,
    CHANCE = 12,
    STATES = 100,
    RATES = 10000,
    PARAMETERS = 20000
};

static bool within(Reference reference, Reference first, size_t count) {
    return reference >= first && reference - first < count;
}

EXPORT fmi3Status fmi3GetFloat64(Instance* i, const Reference references[], size_t n, double values[],
                                 size_t n_values) {
    RigState* rig = &i->rig;
    double rates[MODEL_STATES];
    double indicators[RIG_INDICATORS];
    bool have_rates = false;
    if (n_values != n) return refuse(i, "as many values as references are wanted");
    if (!i->co_simulation) rig_measure(rig);
    rig_indicators(rig, indicators);
    for (size_t k = 0; k < n; ++k) {
        const Reference r = references[k];
        if (within(r, RATES, MODEL_STATES) && !have_rates) {
            rig_rates(rig, rates);
            have_rates = true;
        }
        if (r == TIME) {
            values[k] = rig->time_s;
        } else if (within(r, INPUTS, 2)) {
            values[k] = rig->input_V[r - INPUTS];
        } else if (within(r, OUTPUTS, RIG_AXES)) {
            values[k] = rig->measured_rad[r - OUTPUTS];
        } else if (within(r, INDICATORS, RIG_INDICATORS)) {
            values[k] = indicators[r - INDICATORS];
        } else if (MODEL_RANDOM && r == CHANCE) {
            values[k] = rig->whole[MODEL_STATES + MODEL_TIMED];
        } else if (within(r, STATES, MODEL_STATES)) {
            values[k] = rig->whole[r - STATES];
        } else if (within(r, RATES, MODEL_STATES)) {
            values[k] = rates[r - RATES];
        } else if (within(r, PARAMETERS, MODEL_PARAMETERS)) {
            values[k] = rig->parameters[r - PARAMETERS];
        } else {
            return refuse(i, "there is no variable of this value reference");
        }
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetFloat64(Instance* i, const Reference references[], size_t n, const double values[],
                                 size_t n_values) {
    RigState* rig = &i->rig;
    if (n_values != n) return refuse(i, "as many values as references are wanted");
    for (size_t k = 0; k < n; ++k) {
        const Reference r = references[k];
        if (within(r, INPUTS, 2)) {
            rig->input_V[r - INPUTS] = values[k];
        } else if (MODEL_RANDOM && r == CHANCE) {
            rig->whole[MODEL_STATES + MODEL_TIMED] = values[k];
        } else if (within(r, STATES, MODEL_STATES)) {
            rig->whole[r - STATES] = values[k];
        } else if (within(r, PARAMETERS, MODEL_PARAMETERS)) {
            rig->parameters[r - PARAMETERS] = values[k];
        } else {
            return refuse(i, "this variable cannot be set");
        }
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFMUState(Instance* i, void** state) {
    if (*state == NULL) *state = malloc(sizeof(RigState));
    if (*state == NULL) return fmi3Error;
    memcpy(*state, &i->rig, sizeof(RigState));
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetFMUState(Instance* i, void* state) {
    memcpy(&i->rig, state, sizeof(RigState));
    return fmi3OK;
}

EXPORT fmi3Status fmi3FreeFMUState(Instance* i, void** state) {
    (void)i;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializedFMUStateSize(Instance* i, void* state, size_t* size) {
    (void)i, (void)state;
    *size = sizeof(RigState);
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializeFMUState(Instance* i, void* state, uint8_t bytes[], size_t size) {
    if (size != sizeof(RigState)) return refuse(i, "a state of another size");
    memcpy(bytes, state, size);
    return fmi3OK;
}

EXPORT fmi3Status fmi3DeserializeFMUState(Instance* i, const uint8_t bytes[], size_t size, void** state) {
    if (size != sizeof(RigState)) return refuse(i, "a state of another size");
    if (*state == NULL) *state = malloc(size);
    if (*state == NULL) return fmi3Error;
    memcpy(*state, bytes, size);
    return fmi3OK;
}

EXPORT fmi3Status fmi3EvaluateDiscreteStates(Instance* i) {
    (void)i;
    return fmi3OK;
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(Instance* i, bool* again, bool* terminate, bool* nominals,
                                           bool* states, bool* due, double* next_s) {
    *again = *terminate = *nominals = *states = *due = false;
    if (!i->co_simulation) *states = rig_event(&i->rig, due, next_s);
    return fmi3OK;
}

EXPORT fmi3Status fmi3EnterContinuousTimeMode(Instance* i) {
    (void)i;
    return fmi3OK;
}

EXPORT fmi3Status fmi3CompletedIntegratorStep(Instance* i, bool no_set_state, bool* event, bool* terminate) {
    (void)i, (void)no_set_state;
    *event = *terminate = false;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetTime(Instance* i, double time_s) {
    i->rig.time_s = time_s;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetContinuousStates(Instance* i, const double states[], size_t n) {
    if (n != MODEL_STATES) return refuse(i, "another number of states");
    memcpy(i->rig.whole, states, n * sizeof *states);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(Instance* i, double rates[], size_t n) {
    if (n != MODEL_STATES) return refuse(i, "another number of states");
    rig_rates(&i->rig, rates);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetEventIndicators(Instance* i, double indicators[], size_t n) {
    if (n != RIG_INDICATORS) return refuse(i, "another number of event indicators");
    rig_indicators(&i->rig, indicators);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetContinuousStates(Instance* i, double states[], size_t n) {
    if (n != MODEL_STATES) return refuse(i, "another number of states");
    memcpy(states, i->rig.whole, n * sizeof *states);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(Instance* i, double nominals[], size_t n) {
    if (n != MODEL_STATES) return refuse(i, "another number of states");
    for (size_t k = 0; k < n; ++k) nominals[k] = 1.0;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(Instance* i, size_t* n) {
    (void)i;
    *n = RIG_INDICATORS;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(Instance* i, size_t* n) {
    (void)i;
    *n = MODEL_STATES;
    return fmi3OK;
}

EXPORT fmi3Status fmi3EnterStepMode(Instance* i) {
    (void)i;
    return fmi3OK;
}

EXPORT fmi3Status fmi3DoStep(Instance* i, double at_s, double step_s, bool no_set_state, bool* event,
                             bool* terminate, bool* early, double* last_s) {
    (void)no_set_state;
    *event = *terminate = *early = false;
    if (!(step_s >= 0.0)) return refuse(i, "a communication step must not be negative");
    rig_advance(&i->rig, at_s + step_s);
    *last_s = at_s + step_s;
    return fmi3OK;
}

/* What the standard wants exported and this FMU has nothing of: variables of other types, clocks, dependencies,
 * derivatives, modes. */
#define ABSENT_TYPE(type, c_type)                                                                          \
    EXPORT fmi3Status fmi3Get##type(Instance* i, const Reference r[], size_t n, c_type v[], size_t nv) {       \
        (void)r, (void)v, (void)nv;                                                                            \
        return n == 0 ? fmi3OK : refuse(i, "there are only variables of type Float64");                       \
    }                                                                                                          \
    EXPORT fmi3Status fmi3Set##type(Instance* i, const Reference r[], size_t n, const c_type v[], size_t nv) { \
        (void)r, (void)v, (void)nv;                                                                            \
        return n == 0 ? fmi3OK : refuse(i, "there are only variables of type Float64");                       \
    }
ABSENT_TYPE(Float32, float)
ABSENT_TYPE(Int8, int8_t)
ABSENT_TYPE(UInt8, uint8_t)
ABSENT_TYPE(Int16, int16_t)
ABSENT_TYPE(UInt16, uint16_t)
ABSENT_TYPE(Int32, int32_t)
ABSENT_TYPE(UInt32, uint32_t)
ABSENT_TYPE(Int64, int64_t)
ABSENT_TYPE(UInt64, uint64_t)
ABSENT_TYPE(Boolean, bool)
ABSENT_TYPE(String, char*)

EXPORT fmi3Status fmi3GetBinary(Instance* i, const Reference r[], size_t n, size_t sizes[], const uint8_t* v[], size_t nv) {
    (void)r, (void)n, (void)sizes, (void)v, (void)nv;
    return refuse(i, "fmi3GetBinary has nothing to do here");
}

EXPORT fmi3Status fmi3SetBinary(Instance* i, const Reference r[], size_t n, const size_t sizes[], const uint8_t* const v[], size_t nv) {
    (void)r, (void)n, (void)sizes, (void)v, (void)nv;
    return refuse(i, "fmi3SetBinary has nothing to do here");
}

EXPORT fmi3Status fmi3GetClock(Instance* i, const Reference r[], size_t n, bool v[]) {
    (void)r, (void)n, (void)v;
    return refuse(i, "fmi3GetClock has nothing to do here");
}

EXPORT fmi3Status fmi3SetClock(Instance* i, const Reference r[], size_t n, const bool v[]) {
    (void)r, (void)n, (void)v;
    return refuse(i, "fmi3SetClock has nothing to do here");
}

EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(Instance* i, Reference r, size_t* n) {
    (void)r, (void)n;
    return refuse(i, "fmi3GetNumberOfVariableDependencies has nothing to do here");
}

EXPORT fmi3Status fmi3GetVariableDependencies(Instance* i, Reference r, size_t e[], Reference independents[], size_t ie[], int kinds[], size_t n) {
    (void)r, (void)e, (void)independents, (void)ie, (void)kinds, (void)n;
    return refuse(i, "fmi3GetVariableDependencies has nothing to do here");
}

EXPORT fmi3Status fmi3GetDirectionalDerivative(Instance* i, const Reference u[], size_t nu, const Reference k[], size_t nk, const double seed[], size_t ns, double found[], size_t nf) {
    (void)u, (void)nu, (void)k, (void)nk, (void)seed, (void)ns, (void)found, (void)nf;
    return refuse(i, "fmi3GetDirectionalDerivative has nothing to do here");
}

EXPORT fmi3Status fmi3GetAdjointDerivative(Instance* i, const Reference u[], size_t nu, const Reference k[], size_t nk, const double seed[], size_t ns, double found[], size_t nf) {
    (void)u, (void)nu, (void)k, (void)nk, (void)seed, (void)ns, (void)found, (void)nf;
    return refuse(i, "fmi3GetAdjointDerivative has nothing to do here");
}

EXPORT fmi3Status fmi3EnterConfigurationMode(Instance* i) {
    return refuse(i, "fmi3EnterConfigurationMode has nothing to do here");
}

EXPORT fmi3Status fmi3ExitConfigurationMode(Instance* i) {
    return refuse(i, "fmi3ExitConfigurationMode has nothing to do here");
}

EXPORT fmi3Status fmi3GetIntervalDecimal(Instance* i, const Reference r[], size_t n, double v[], int q[]) {
    (void)r, (void)n, (void)v, (void)q;
    return refuse(i, "fmi3GetIntervalDecimal has nothing to do here");
}

EXPORT fmi3Status fmi3GetIntervalFraction(Instance* i, const Reference r[], size_t n, uint64_t c[], uint64_t v[], int q[]) {
    (void)r, (void)n, (void)c, (void)v, (void)q;
    return refuse(i, "fmi3GetIntervalFraction has nothing to do here");
}

EXPORT fmi3Status fmi3GetShiftDecimal(Instance* i, const Reference r[], size_t n, double v[]) {
    (void)r, (void)n, (void)v;
    return refuse(i, "fmi3GetShiftDecimal has nothing to do here");
}

EXPORT fmi3Status fmi3GetShiftFraction(Instance* i, const Reference r[], size_t n, uint64_t c[], uint64_t v[]) {
    (void)r, (void)n, (void)c, (void)v;
    return refuse(i, "fmi3GetShiftFraction has nothing to do here");
}

EXPORT fmi3Status fmi3SetIntervalDecimal(Instance* i, const Reference r[], size_t n, const double v[]) {
    (void)r, (void)n, (void)v;
    return refuse(i, "fmi3SetIntervalDecimal has nothing to do here");
}

EXPORT fmi3Status fmi3SetIntervalFraction(Instance* i, const Reference r[], size_t n, const uint64_t c[], const uint64_t v[]) {
    (void)r, (void)n, (void)c, (void)v;
    return refuse(i, "fmi3SetIntervalFraction has nothing to do here");
}

EXPORT fmi3Status fmi3SetShiftDecimal(Instance* i, const Reference r[], size_t n, const double v[]) {
    (void)r, (void)n, (void)v;
    return refuse(i, "fmi3SetShiftDecimal has nothing to do here");
}

EXPORT fmi3Status fmi3SetShiftFraction(Instance* i, const Reference r[], size_t n, const uint64_t c[], const uint64_t v[]) {
    (void)r, (void)n, (void)c, (void)v;
    return refuse(i, "fmi3SetShiftFraction has nothing to do here");
}

EXPORT fmi3Status fmi3GetOutputDerivatives(Instance* i, const Reference r[], size_t n, const int32_t orders[], double v[], size_t nv) {
    (void)r, (void)n, (void)orders, (void)v, (void)nv;
    return refuse(i, "fmi3GetOutputDerivatives has nothing to do here");
}

EXPORT fmi3Status fmi3ActivateModelPartition(Instance* i, Reference clock, double at_s) {
    (void)clock, (void)at_s;
    return refuse(i, "fmi3ActivateModelPartition has nothing to do here");
}
