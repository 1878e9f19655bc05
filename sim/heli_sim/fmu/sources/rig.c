#include "rig.h"

#include <math.h>
#include <string.h>

#include "model.h"

static const double RAD = 3.14159265358979323846 / 180.0;
/* Share of a millisecond by which times of an importer may be off their multiples. */
static const double SLACK = 1e-6;

/* CasADi's functions take and give arrays of arrays. */
typedef int (*Function)(const double** arg, double** res, long long int* iw, double* w, int mem);

static void call(Function function, const double** arg, double** res) {
    long long int integers[MODEL_WORK_INTEGERS];
    double numbers[MODEL_WORK_NUMBERS];
    const double* args[MODEL_WORK_ARGUMENTS];
    double* results[MODEL_WORK_RESULTS];
    memcpy(args, arg, MODEL_INPUTS * sizeof *arg);
    memcpy(results, res, MODEL_OUTPUTS * sizeof *res);
    function(args, results, integers, numbers, 0);
}

static double* states(RigState* rig) {
    return rig->whole;
}

#if MODEL_LATE
static double* past_V(RigState* rig) {
    return rig->whole + MODEL_STATES + MODEL_TIMED + MODEL_RANDOM;
}
#endif

/* The model's time stands while no motor has turned, but for the millisecond that is being passed. */
static double turned_s(const RigState* rig) {
    if (!MODEL_TIMED) return 0.0;
    return rig->time_s - (rig->turning ? rig->turning_since_s : rig->tick_began_s);
}

static const double* acting_V(const RigState* rig) {
    return MODEL_LATE ? rig->acting_V : rig->input_V;
}

void rig_reset(RigState* rig) {
    memset(rig, 0, sizeof *rig);
    memcpy(rig->whole, model_start_state, sizeof rig->whole);
    memcpy(rig->parameters, model_start_parameters, sizeof rig->parameters);
    rig_measure(rig);
}

void rig_begin(RigState* rig, double start_s) {
    rig->start_s = rig->time_s = rig->tick_began_s = start_s;
    rig->ticks = 0.0;
    rig_measure(rig);
}

void rig_advance(RigState* rig, double until_s) {
    static const double free_axes[RIG_AXES] = {0.0, 0.0, 0.0};
    while (rig->start_s + (rig->ticks + 1.0 - SLACK) * RIG_STEP_S <= until_s) {
        double after[MODEL_WHOLE];
        const double* arg[MODEL_INPUTS] = {rig->whole, rig->input_V, free_axes, rig->parameters};
        double* res[MODEL_OUTPUTS] = {after, rig->measured_rad};
        call(plant_step, arg, res);
        memcpy(rig->whole, after, sizeof after);
        rig->ticks += 1.0;
        rig->time_s = rig->start_s + rig->ticks * RIG_STEP_S;
    }
}

void rig_measure(RigState* rig) {
    const double turned = turned_s(rig);
    const double* arg[MODEL_INPUTS] = {rig->whole, acting_V(rig), rig->parameters, &turned};
    double* res[MODEL_OUTPUTS] = {rig->measured_rad};
    call(model_measured, arg, res);
}

void rig_rates(const RigState* rig, double* rates) {
    const double turned = turned_s(rig);
    const double* arg[MODEL_INPUTS] = {rig->whole, acting_V(rig), rig->parameters, &turned};
    double* res[MODEL_OUTPUTS] = {rates};
    call(model_rates, arg, res);
}

void rig_indicators(const RigState* rig, double* indicators) {
    const double* limits = rig->parameters + MODEL_LIMITS;
    const double low[RIG_AXES] = {limits[0], -limits[2], -limits[3]};
    const double high[RIG_AXES] = {limits[1], limits[2], limits[3]};
    for (int axis = 0; axis < RIG_AXES; ++axis) {
        indicators[axis] = rig->whole[axis] - low[axis] * RAD;
        indicators[RIG_AXES + axis] = high[axis] * RAD - rig->whole[axis];
    }
}

static bool touches(const RigState* rig) {
    double indicators[RIG_INDICATORS];
    rig_indicators(rig, indicators);
    for (int i = 0; i < RIG_INDICATORS; ++i) {
        if (indicators[i] <= 0.0) return true;
    }
    return false;
}

// Applies what changes at the end of a sampled millisecond (stops, effects with jumps, random state),
// then shifts the delayed voltages by one.
static void end_step(RigState* rig) {
    const double turned = rig->turning ? turned_s(rig) : 0.0;
    double chance = MODEL_RANDOM ? rig->whole[MODEL_STATES + MODEL_TIMED] : 0.0;
    double after[MODEL_STATES];
    double next_chance;
    const double* u = MODEL_LATE ? rig->acting_V : rig->commanded_V;
    const double* arg[MODEL_INPUTS] = {rig->whole, u, rig->parameters, &turned, &chance};
    double* res[MODEL_OUTPUTS] = {after, &next_chance};
    call(model_end_of_step, arg, res);
    memcpy(states(rig), after, sizeof after);
    if (MODEL_RANDOM) rig->whole[MODEL_STATES + MODEL_TIMED] = next_chance;
#if MODEL_LATE
    double* past = past_V(rig);
    memmove(past + 2, past, 2 * (MODEL_LATE - 1) * sizeof *past);
    memcpy(past, rig->commanded_V, sizeof rig->commanded_V);
#endif
}

bool rig_event(RigState* rig, bool* due, double* next_s) {
    bool changed = false;
    const bool step_over =
        rig->sampling && rig->time_s >= rig->tick_began_s + (1.0 - SLACK) * RIG_STEP_S;
    if (rig->begun && (step_over || (!rig->sampling && touches(rig)))) {
        end_step(rig);
        changed = true;
    }
    if (MODEL_TIMED && !rig->turning && (rig->input_V[0] != 0.0 || rig->input_V[1] != 0.0)) {
        rig->turning = true;
        rig->turning_since_s = rig->time_s;
    }
    const bool was_sampling = rig->sampling;
    rig->sampling = MODEL_SAMPLED || touches(rig) || (MODEL_TIMED && !rig->turning);
    if (step_over || !rig->begun || (rig->sampling && !was_sampling)) {
        rig->tick_began_s = rig->time_s;
        memcpy(rig->commanded_V, rig->input_V, sizeof rig->input_V);
#if MODEL_LATE
        const double* arg[MODEL_INPUTS] = {rig->commanded_V, past_V(rig)};
        double* res[MODEL_OUTPUTS] = {rig->acting_V};
        call(model_late_volts, arg, res);
#endif
    }
    rig->begun = true;
    rig_measure(rig);
    *due = rig->sampling;
    *next_s = rig->tick_began_s + RIG_STEP_S;
    return changed;
}
