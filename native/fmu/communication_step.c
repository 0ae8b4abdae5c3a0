/* Communication steps as fmu_src/cosimulation/communication_step.py makes them, of internal steps, halved if one fails. */
#include "component.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double ON_GRID = 1e-6, LONGEST = 4.0 / 3.0;
static const double TIMES[4] = {0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0};

double rounded(double dt)
{
    char digits[40];
    snprintf(digits, sizeof(digits), "%.9g", dt);
    return strtod(digits, NULL);
}

communication_step step_of(const component *c, double h, const double *venous)
{
    const double *const x = c->numbers, ratio = h / x[DT];
    communication_step s = {h, x[DT], (int64_t)rint(ratio), (int32_t)x[NOW], x + c->now, venous};
    if (s.steps == 0 || fabs(ratio - (double)s.steps) > ON_GRID) {
        const int64_t least = (int64_t)ceil(ratio / LONGEST);
        if (least > s.steps) s.steps = least;
        if (s.steps < 1) s.steps = 1;
        s.dt = rounded(h / (double)s.steps);
    }
    return s;
}

double *bound(component *c, int32_t program, const double *parameters, double dt)
{
    const size_t bytes = sizeof(double) * (size_t)c->r.n_parameters;
    const double length = value_of(c, c->r.meta[VR_LENGTH]);
    slot *s = &c->slots[0];
    for (int i = 0; i < SLOTS; i++) {
        slot *const other = &c->slots[i];
        if (other->dt == dt && other->length == length && other->program == program &&
            !memcmp(other->parameters, parameters, bytes)) {
            other->used = ++c->clock;
            return other->fixed;
        }
        if (other->used < s->used) s = other;
    }
    const recorded *const one = &c->r.recorded[program];
    const memory m = memory_for(c, program, s->fixed);
    const double given[2] = {dt, length};
    memset(s->fixed, 0, sizeof(double) * (size_t)one->program.n_fixed);
    s->dt = 0.0; /* of none, until it is made */
    for (int i = 0; i < 3; i++)
        if (one->further[i] >= 0) memcpy(placed(&m, one->further[i]), i ? &given[i - 1] : parameters, i ? sizeof(double) : bytes);
    if (!run(&one->program, &m, BIND)) return NULL;
    s->dt = dt;
    s->length = length;
    s->program = program;
    s->used = ++c->clock;
    memcpy(s->parameters, parameters, bytes);
    return s->fixed;
}

memory memory_for(component *c, int32_t program, double *fixed)
{
    return memory_of(&c->r.recorded[program].program, fixed, c->work);
}

double *further(component *c, int32_t program, const memory *m, int which)
{
    return placed(m, c->r.recorded[program].further[which]);
}

double shown_of(component *c, int32_t program, const double *parameters, const double *position, double t,
                const double *venous, double *answers, double *flows)
{
    const arterial_program *const p = &c->r.recorded[program].program;
    const double *const state = position + AT_DRIVE + c->r.n_inlets;
    double dt = c->numbers[DT];
    for (int i = 0; i < SLOTS; i++) /* any will do that is made */
        if (c->slots[i].dt > 0.0 && c->slots[i].program == program &&
            !memcmp(c->slots[i].parameters, parameters, sizeof(double) * (size_t)c->r.n_parameters))
            dt = c->slots[i].dt;
    double *const fixed = bound(c, program, parameters, dt);
    if (!fixed) return NAN;
    const memory m = memory_for(c, program, fixed);
    memcpy(placed(&m, p->place[IN_Y_REPORT]), state, sizeof(double) * (size_t)p->n_y);
    memcpy(placed(&m, p->place[IN_H_REPORT]), state + p->n_y + p->n_A, sizeof(double) * (size_t)p->n_H);
    memcpy(further(c, program, &m, IN_VENOUS_SHOW), venous, sizeof(double) * (size_t)p->n_outlets);
    memcpy(further(c, program, &m, IN_G_SHOW), acting_at(c, t, 0.0), sizeof(double) * (size_t)p->n_sources);
    run(p, &m, SHOW);
    if (answers) memcpy(answers, further(c, program, &m, OUT_ANSWERS), sizeof(double) * (size_t)p->n_inlets);
    if (flows) memcpy(flows, further(c, program, &m, OUT_VENOUS_FLOW), sizeof(double) * (size_t)p->n_outlets);
    return *further(c, program, &m, OUT_V);
}

/* The unknowns of the last two steps, as if these had been of length dt: at_stages_of in solver/scheme/step.py. */
static void as_long_as(const arterial_program *p, double *state, double before, double dt)
{
    const int32_t n = p->n_Q + p->n_H;
    double *const last = state + p->n_y + p->n_A + p->n_H, *const early = last + STAGES * n;
    if (dt == before || before == 0.0) return;
    for (int32_t i = 0; i < n; i++) {
        const double end = last[(STAGES - 1) * n + i], slope = (end - early[(STAGES - 1) * n + i]) * (dt / before);
        for (int k = 0; k < STAGES; k++) {
            const double at = SDIRK3[k][0] + SDIRK3[k][1] + SDIRK3[k][2];
            last[k * n + i] = dt > 10.0 * before ? end : end + (at - 1.0) * slope;
            early[k * n + i] = dt > 10.0 * before ? end : end + (at - 2.0) * slope;
        }
    }
}

/* What has flowed in at an inlet in a step: volume_entered in solver/scheme/outputs.py. */
static double entered(const arterial_program *p, int32_t column, const double *before, const double *after, double dt)
{
    const double *const rates = after + p->n_y + p->n_A + p->n_H + column - p->at_Q;
    double found = 0.0;
    for (int k = 0; k < STAGES; k++) {
        double Q = 0.0;
        for (int j = 0; j < STAGES; j++) Q += SDIRK3[k][j] * rates[j * (p->n_Q + p->n_H)];
        found += SDIRK3[STAGES - 1][k] * (before[column] + dt * Q);
    }
    return dt * found;
}

/* The drive of one half of a step, by the same cubic. */
void half_of(const double *drive, int32_t n, int half, double *found)
{
    for (int k = 0; k < 4; k++)
        for (int32_t i = 0; i < n; i++) {
            const double u = 0.5 * (half + TIMES[k]);
            double sum = 0.0;
            for (int j = 0; j < 4; j++) {
                double weight = 1.0;
                for (int m = 0; m < 4; m++) weight *= m == j ? 1.0 : (u - TIMES[m]) / (TIMES[j] - TIMES[m]);
                sum += weight * drive[4 * i + j];
            }
            found[4 * i + k] = sum;
        }
}

/* A step, or its parts, from a position: 1, 0 where it is not solved, -1 where it is not physical. counted : by inlet. */
static int advance(component *c, const communication_step *s, double *position, double t, double dt, int depth, int own)
{
    const recorded *const one = &c->r.recorded[s->program];
    const arterial_program *const p = &one->program;
    const size_t bytes = sizeof(double) * (size_t)c->r.n_state;
    double *const state = position + AT_DRIVE + c->r.n_inlets, *const drive = c->drives[depth];
    double *const fixed = bound(c, s->program, s->parameters, dt);
    if (!fixed) return snprintf(c->failure, ROOM, "the equations at rest are singular."), 0;
    const memory m = memory_for(c, s->program, fixed);
    memcpy(c->spare, state, bytes);
    as_long_as(p, c->spare, position[AT_DT], dt);
    memcpy(placed(&m, p->place[IN_DRIVE]), drive, sizeof(double) * 4 * (size_t)p->n_inlets);
    memcpy(placed(&m, p->place[IN_VENOUS]), s->venous, sizeof(double) * (size_t)p->n_outlets);
    const int done = step(p, &m, dt, c->spare, c->after, acting_at(c, t, dt));
    if (done > 0) {
        if (c->d && !derivative_step(c, s, t, dt, depth, own)) return 0;
        for (int32_t i = 0; i < p->n_inlets; i++)
            if (own || !c->r.inlets[PER_INLET * i + BY_FLOW])
                position[V_IN] += entered(p, one->first[i], state, c->after, dt);
        memcpy(state, c->after, bytes);
        position[AT_DT] = dt;
        return 1;
    }
    if (!depth) explain(c, s->program, &m, done == 0, t + dt);
    if (done < 0 || depth == HALVINGS) return done;
    position[HALVED] += 1.0;
    for (int half = 0; half < 2; half++) {
        half_of(drive, p->n_inlets, half, c->drives[depth + 1]);
        if (c->d) derivative_half(c, half, depth);
        if (advance(c, s, position, t + half * 0.5 * dt, 0.5 * dt, depth + 1, own) <= 0) return 0;
    }
    return 1;
}

int run_straight(component *c, const communication_step *s, double *position, double t, const double *start, const double *end)
{
    const int32_t n = c->r.n_inlets;
    double total = 0.0;
    for (int32_t i = 0; i < n; i++)
        if (c->r.inlets[PER_INLET * i + BY_FLOW]) total += start[i] + end[i];
    const double flowed = 0.5 * (double)s->steps * s->dt * total;
    for (int32_t i = 0; i < n; i++) { /* start may be the position's own */
        c->given[i] = start[i];
        c->given[n + i] = (end[i] - start[i]) / (double)s->steps;
        c->given[2 * n + i] = end[i];
    }
    for (int64_t k = 0; k < s->steps; k++) {
        for (int32_t i = 0; i < n; i++)
            for (int j = 0; j < 4; j++) c->drives[0][4 * i + j] = c->given[i] + ((double)k + TIMES[j]) * c->given[n + i];
        if (c->d) derivative_drive(c, k, s->steps);
        if (advance(c, s, position, t + (double)k * s->dt, s->dt, 0, 0) <= 0) return 0;
    }
    memcpy(position + AT_DRIVE, c->given + 2 * n, sizeof(double) * (size_t)n);
    position[V_IN] += flowed;
    if (c->d) derivative_came(c, (double)s->steps * s->dt);
    return 1;
}

int run_along(component *c, const communication_step *s, double *position, double t)
{
    for (int64_t k = 0; k < s->steps; k++) {
        for (int32_t i = 0; i < c->r.n_inlets; i++)
            for (int j = 0; j < 4; j++) c->drives[0][4 * i + j] = drive_at(c, i, t + ((double)k + TIMES[j]) * s->dt);
        if (c->d) derivative_drive(c, k, 0);
        if (advance(c, s, position, t + (double)k * s->dt, s->dt, 0, 1) <= 0) return 0;
    }
    for (int32_t i = 0; i < c->r.n_inlets; i++) position[AT_DRIVE + i] = c->drives[0][4 * i + 3];
    return 1;
}
