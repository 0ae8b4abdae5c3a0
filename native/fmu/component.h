/* A co-simulation component of arteries without FMI: what an FMU holds, and what both versions of the standard ask. */
#ifndef ARTERIAL_COMPONENT_H
#define ARTERIAL_COMPONENT_H

#include "../engine.h"
#include "../run.h"

#include <stddef.h>

/* For importers that compile without -fvisibility=hidden: else a function of the same name in the host would take the
   place of ours. */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* --- the resource: arrays in one file, as fmu_src/native/resource.py writes them -------------------------------------------- */

enum { SOME_BYTES, SOME_INTEGERS, SOME_NUMBERS };
enum { META, GUID, OPERATIONS, VARIABLES, RANGES, STRINGS, PARAMETERS, INLETS, INLET_NUMBERS, CURVES, VENOUS,
       SEGMENTS, ELEMENTS, POSITIONS, PERIODIC, SOURCES, SOURCE_PERIODS, INDEX, NUMBERS, PROGRAMS };
enum { PROGRAM_META, CODE, BEGIN, DERIVED_META, DERIVED_CODE, DERIVED_BEGIN, PER_PROGRAM }; /* of each program, from PROGRAMS on */
/* META */
enum { N_VARIABLES, FIRST_OUTPUT, FIRST_LATE, N_POINTS, N_PROGRAMS, VR_DT, VR_LENGTH, VR_ELASTIC, VR_VISCOUS,
       VR_INTERPOLATION, VR_DRIVE, VR_START, VR_T, VR_P_0, TEXT_NAME, TEXT_UNSOLVED, TEXT_SHORTER,
       N_ARITHMETIC, N_META }; /* N_ARITHMETIC : numbers of the state of a heart or a body; 0: arteries */
/* VARIABLES, a row each */
enum { KIND, CAUSALITY, VARIABILITY, FLAGS, CHOICES, NAME, DESCRIPTION, UNIT, ITEMS, PER_VARIABLE };
enum { REAL, ENUMERATION };
enum { INPUT, PARAMETER, OUTPUT };
enum { CONTINUOUS, FIXED, TUNABLE };
enum { OPEN_LOW = 1, WHOLE = 2 };
enum { START_VALUE, LOW, HIGH, PER_RANGE };
/* INLETS, and INLET_NUMBERS */
enum { VR_INLET, VR_MEAN, BY_FLOW, CURVE, CURVE_AT, CURVE_SIZE, PER_INLET };
enum { NO_CURVE, HALF_SINE, CUBIC, FOURIER };
enum { OWN_MEAN, OWN_T, OWN_MAX, PER_INLET_NUMBERS };
enum { VR_VENOUS, OUTLET_SEGMENT, PER_VENOUS };
enum { SOURCE_CURVE, SOURCE_AT, SOURCE_SIZE, PER_SOURCE }; /* SOURCES */
enum { SEGMENT_NAME, VR_L, VR_PHI0, VR_PHINL, PER_SEGMENT };
/* PROGRAM_META: laws (0 any), counts as in arterial_program, places, further ones, columns of the inlets, reasons */
enum { ELASTIC, VISCOUS, N_MARGINS, COUNTS, N_COUNTS = 11, AT_PLACES = COUNTS + N_COUNTS };

/* Programs of hearts and bodies: of the initialization, of a step, of the derivatives of its outputs. PROGRAM_META: counts
   and places, -1 for what is not read; then loops, then requirements. */
enum { BEGINS, STEPS, DERIVES, A_PROGRAMS };
enum { N_FIXED, N_WORK, N_LOOPS, N_REQUIREMENTS, GIVEN_VALUES, GIVEN_STATE, GIVEN_T, GIVEN_H, GIVEN_DIRECTION,
       NEXT_STATE, OUTPUTS, A_HEAD };
enum { LOOP_SIZE, LOOP_BEGIN, LOOP_BEFORE, LOOP_AFTER, PER_LOOP };
enum { REQUIRED_IN, CONDITION, SENTENCE, FIRST_NUMBER, PER_REQUIREMENT = FIRST_NUMBER + 4 };

/* DERIVED_META, empty where there is none: n_fixed, n_work, places as in derivative.c. */
enum { D_PHASES = PHASES + 1, D_PLACES = 43 };

/* Phases after those of engine.h, and places after those there: in the order of solver/tracing/component.py. */
enum { EXPLAIN = PHASES, SHOW };
enum { MOST_MARGINS = 4 };
enum { IN_PARAMETERS, IN_DT, IN_LENGTH, OUT_Y_REST, OUT_A_REST, OUT_LOST_AT_REST, OUT_SMALL_DRIVES, OUT_SMALL_VENOUS,
       OUT_END_IMPEDANCE, OUT_PHI0, OUT_A0, OUT_R, OUT_LOST, OUT_MARGINS,
       IN_VENOUS_SHOW = OUT_MARGINS + MOST_MARGINS, OUT_V, OUT_ANSWERS, OUT_VENOUS_FLOW, IN_G_SHOW, FURTHER };

typedef struct {
    arterial_program program;
    const int32_t *meta, *further, *first, *reasons; /* first : columns of the inlets; reasons : two texts a margin */
    arterial_program derived; /* of derivatives, and its places; NULL where there is none */
    const int32_t *derived_places;
} recorded;

typedef struct {
    void *bytes;
    int32_t n_arrays;
    const int32_t *meta, *variables, *parameters, *inlets, *venous, *segments, *elements, *sources;
    const double *ranges, *inlet_numbers, *curves, *positions, *periodic, *source_periods;
    const char *guid, *strings;
    int32_t n_parameters, n_inlets, n_outlets, n_segments, n_elements, n_periodic, n_sources, n_state;
    recorded *recorded;
} resource;

/* Reads a file; 0 with a sentence where it is not whole. */
int resource_read(resource *r, const char *folder, char *why, size_t room);
void resource_free(resource *r);
uint64_t digest(const void *bytes, size_t n);

/* --- the component --------------------------------------------------------------------------------------------------- */

enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };
enum { HOLD = 1, LINEAR, SMOOTH };

/* All that a state holds is numbers, one after the other: first these. */
enum { STATE_OF, T0, STOP, HAS_STOP, OUTDATED, LATE_DUE, CHANGED, RETUNED, READY, NOW, DT, TIME, WAY, OWN, FRESH, V_NOW, V_0,
       V_VENOUS, Q_VENOUS, BASIS_TIME, FOUND, HEARD, LAST_H, LAST_STEPS, LAST_DT, BASIS_H, BASIS_STEPS, BASIS_DT,
       BASIS_KNOWN, N_HEAD };
/* Numbers of a position, before the engine's of its state. */
enum { AT_DT, HALVED, V_IN, AT_DRIVE };

enum { SLOTS = 6, ROOM = 1024, HALVINGS = 4 };

typedef struct {
    double h, dt;
    int64_t steps;
    int32_t program;
    const double *parameters, *venous;
} communication_step;

typedef struct {
    double dt, length, used; /* length : solver.element_length, which the mesh must have */
    int32_t program;
    double *parameters, *fixed;
} slot;

typedef struct {
    resource r;
    double *numbers, *before;          /* the state, and the one to come back to */
    int64_t n_numbers, n_position;
    /* in both: */
    int64_t values, now, slope, unset, last_venous, basis_venous, Z, Z_0, Z_out, known, shown, basis_known,
        basis_shown;
    double *work, *tried[3], *spare, *after, *row, *answers, *flows, *given, *drives[HALVINGS + 2], *pressures, *acting, clock;
    slot slots[SLOTS];
    struct derivative *derivative, *d; /* made when it is asked for; d : while a step is made again for it */
    int stepped;                       /* whether before is where the last step began */
    char said[ROOM], remark[ROOM], failure[ROOM];
} component;

component *component_new(const char *folder, const char *guid, char *why, size_t room);
void component_free(component *c);
void component_reset(component *c);

/* Each returns 0 with a sentence in c->said, and the numbers as before. remark : one for a warning, or "". A step in
   another phase than STEPPING returns -1. */
const char *component_said(const component *c);
int component_may_be(const component *c, const double *numbers); /* whether they can be the numbers of a state */
int component_set_up(component *c, double start, int has_stop, double stop);
int component_enter(component *c);
int component_leave(component *c);
int component_step(component *c, double t, double h);
int component_read(component *c, const uint32_t *vr, size_t n, int kind, double *values);
int component_write(component *c, const uint32_t *vr, size_t n, int kind, const double *values);

/* In the direction seed of inputs and tunable parameters: how outputs after the last step would change. */
int component_derivative(component *c, const uint32_t *unknown, size_t n, const uint32_t *known, size_t m,
                         const double *seed, double *found);

/* --- its parts --------------------------------------------------------------------------------------------------------- */

int say(component *c, const char *format, ...); /* into said; returns 0 */
const char *text(const component *c, int32_t at);
double value_of(const component *c, int32_t vr);
const int32_t *variable(const component *c, uint32_t vr);
const char *name_of(const component *c, uint32_t vr);
void keep(component *c); /* the numbers, to come back to */
int back(component *c);  /* returns 0 */
int initialized(component *c);
/* Takes the values of all parameters over, with the first program that has what they need. Where none has, it says which
   of them is to blame, and leaves values changed: the caller puts them back. */
int take_over(component *c);

/* The block of numbers for a program, its parameters and a step; NULL with a sentence. */
double *bound(component *c, int32_t program, const double *parameters, double dt);
memory memory_for(component *c, int32_t program, double *fixed);
double *further(component *c, int32_t program, const memory *m, int which);

/* Runs along straight lines, or along the network's own curves from a time t; 0 with a sentence in failure. */
int run_straight(component *c, const communication_step *s, double *position, double t, const double *start, const double *end);
int run_along(component *c, const communication_step *s, double *position, double t);
double drive_at(component *c, int32_t inlet, double t);
const double *acting_at(component *c, double t, double dt); /* of tables, at t and at the stages of a step from there */
communication_step step_of(const component *c, double h, const double *venous);
double rounded(double dt);

void half_of(const double *drive, int32_t n, int half, double *found); /* of a step, by the same cubic */

/* The last step again, from the numbers before it: how many bytes these are. */
size_t step_bytes(const component *c);
int component_again(component *c, double t, double h);

/* While c->d is there: a position begins a communication step whose drives have directions start and end times those of inputs;
   acts : whether parameters have theirs. */
enum { KNOWN, SHOWN, KNOWN_AS_SHOWN };
int derivative_begins(component *c, const double *position, int which, int acts, double start, double end);
void derivative_drive(component *c, int64_t k, int64_t steps); /* of internal step k; steps = 0: none */
void derivative_half(component *c, int half, int depth);
void derivative_came(component *c, double time); /* by given flows */
int derivative_step(component *c, const communication_step *s, double t, double dt, int depth, int own);

/* Volume, answers and venous flows of a position at a time t; returns the volume. */
double shown_of(component *c, int32_t program, const double *parameters, const double *position, double t,
                const double *venous, double *answers, double *flows);
/* The sentence for a step that was not solved, or is not physical. */
void explain(component *c, int32_t program, const memory *m, int solved, double t);
int ports(component *c, double *values);

int outputs_are_finite(component *c);
/* Whether a step may begin at t, which is slack [s] from where the component stands at most. */
int begins_here(component *c, double t, double h, double slack);

/* The same for hearts and bodies. */
int arithmetic_read(const resource *r, const recorded *one, int32_t n, int32_t n_begin);
int arithmetic_initialized(component *c);
int arithmetic_stepped(component *c, double t, double h);
int arithmetic_derived(component *c, double t, double h, const double *direction); /* in place of the outputs */

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif
#endif
