/* A rig in time: what an instance remembers, and how it passes a millisecond, an event and a moment between. */
#ifndef RIG_H
#define RIG_H

#include <stdbool.h>

#include "model_numbers.h"

#define RIG_STEP_S 0.001
#define RIG_AXES 3
#define RIG_INDICATORS 6

typedef struct {
    double whole[MODEL_WHOLE]; /* states, then time since the motors turned, chance, voltages of the past */
    double parameters[MODEL_PARAMETERS];
    double input_V[2];
    double measured_rad[RIG_AXES];
    double start_s;
    double time_s;
    /* Co-simulation: milliseconds passed since start_s. */
    double ticks;
    /* Model exchange: when the last sampled millisecond began, and what was commanded and acted in it. */
    double tick_began_s;
    double commanded_V[2];
    double acting_V[2];
    double turning_since_s;
    bool turning;
    bool sampling;
    bool begun;
} RigState;

void rig_reset(RigState* rig);
void rig_begin(RigState* rig, double start_s);

/* Co-simulation: pass the whole milliseconds that end no later than `until_s`. */
void rig_advance(RigState* rig, double until_s);

/* Model exchange. An event: the end of a sampled millisecond, or an angle that has met a stop. Returns whether
 * states changed; `*next_s` is when the next is due, if `*due`. */
bool rig_event(RigState* rig, bool* due, double* next_s);
void rig_rates(const RigState* rig, double* rates);
/* Positive while an angle is inside its stops: elevation, pitch and travel below, then above. */
void rig_indicators(const RigState* rig, double* indicators);

/* Angles that the encoders see now. */
void rig_measure(RigState* rig);

#endif
