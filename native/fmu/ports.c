/* How pressure and flow at the ends answer each other over the next communication step: fmu_src/cosimulation/ports.py. */
#include "component.h"

#include <math.h>
#include <string.h>

static const double SMALL = 1e-3, CLOSED = 1e15;
static const int64_t IN_AT_MOST = 3;

static communication_step basis_of(const component *c)
{
    const double *const x = c->numbers;
    communication_step s = {x[BASIS_H], x[BASIS_DT], (int64_t)x[BASIS_STEPS], (int32_t)x[NOW], x + c->now, c->pressures};
    if (x[WAY] != HOLD && s.steps > IN_AT_MOST) {
        s.steps = IN_AT_MOST;
        s.dt = rounded(s.h / (double)IN_AT_MOST);
    }
    return s;
}

/* What a trial of the basis' step leads to, with the drives changed to Q: its answers and venous flows. */
static int tried(component *c, const double *Q, double *answers, double *flows)
{
    const double *const x = c->numbers;
    const communication_step s = basis_of(c);
    double *const position = c->tried[0];
    memcpy(position, x + c->basis_shown, sizeof(double) * (size_t)c->n_position);
    if (!run_straight(c, &s, position, x[BASIS_TIME], x[WAY] == HOLD ? Q : position + AT_DRIVE, Q)) return 0;
    shown_of(c, s.program, s.parameters, position, x[BASIS_TIME] + s.h, s.venous, answers, flows);
    return 1;
}

/* The same where the flow at the start of the step is not known yet, nor at the end of the one before. */
static int tried_smooth(component *c, const double *Q, double *answers)
{
    const double *const x = c->numbers;
    const communication_step s = basis_of(c);
    double *const position = c->tried[0];
    memcpy(position, x + c->basis_known, sizeof(double) * (size_t)c->n_position);
    const double t = x[BASIS_KNOWN];
    if (!run_straight(c, &s, position, t, position + AT_DRIVE, Q) ||
        !run_straight(c, &s, position, t + s.h, Q, x + c->basis_shown + AT_DRIVE))
        return 0;
    shown_of(c, s.program, s.parameters, position, t + 2.0 * s.h, s.venous, answers, NULL);
    return 1;
}

static int impedances(component *c, const double *small_drives, const double *small_venous)
{
    double *const x = c->numbers, *const Q = c->tried[1], *const plain = c->answers, *const other = plain + c->r.n_inlets;
    double *const flows = c->flows, *const less = flows + c->r.n_outlets;
    const int32_t k = c->r.n_inlets, n = c->r.n_outlets;
    memcpy(Q, x + c->basis_shown + AT_DRIVE, sizeof(double) * (size_t)k);
    memcpy(c->pressures, x + c->basis_venous, sizeof(double) * (size_t)n);
    if (!tried(c, Q, plain, flows)) return 0;
    for (int32_t i = 0; i < k; i++) {
        const double was = Q[i], change = SMALL * small_drives[i];
        Q[i] = was + change;
        if (!tried(c, Q, other, NULL)) return 0;
        x[c->Z + i] = (other[i] - plain[i]) / change;
        Q[i] = was;
    }
    for (int32_t i = 0; i < n; i++) {
        const double was = c->pressures[i], change = SMALL * small_venous[i];
        c->pressures[i] = was + change;
        if (!tried(c, Q, other, less)) return 0;
        x[c->Z_out + i] = change / fmax(flows[i] - less[i], change / CLOSED);
        c->pressures[i] = was;
    }
    for (int32_t i = 0; i < k; i++) x[c->Z_0 + i] = 0.0;
    if (x[WAY] != SMOOTH) return 1;
    if (!tried_smooth(c, Q, plain)) return 0;
    for (int32_t i = 0; i < k; i++) {
        const double was = Q[i], change = SMALL * small_drives[i];
        Q[i] = was + change;
        if (!tried_smooth(c, Q, other)) return 0;
        x[c->Z_0 + i] = (other[i] - plain[i]) / change;
        Q[i] = was;
    }
    return 1;
}

/* The next step under the extrapolated drive; where it breaks down, the present position. */
static const double *trial(component *c, const communication_step *s, double *t)
{
    double *const x = c->numbers, *const position = c->tried[0], *const Q = c->tried[1];
    memcpy(position, x + c->shown, sizeof(double) * (size_t)c->n_position);
    for (int32_t i = 0; i < c->r.n_inlets; i++) Q[i] = position[AT_DRIVE + i] + x[c->slope + i] * s->h;
    const int done = x[OWN] != 0.0 ? run_along(c, s, position, x[TIME])
                                   : run_straight(c, s, position, x[TIME], x[WAY] == HOLD ? Q : position + AT_DRIVE, Q);
    *t = x[TIME] + (done ? s->h : 0.0);
    return done ? position : x + c->shown;
}

int ports(component *c, double *values)
{
    double *const x = c->numbers;
    const int32_t program = (int32_t)x[NOW], k = c->r.n_inlets, n = c->r.n_outlets;
    double *const fixed = bound(c, program, x + c->now, x[DT]);
    if (!fixed) return say(c, "the equations at rest are singular.");
    const memory m = memory_for(c, program, fixed);
    if (x[FOUND] == 0.0) {
        double *const small = c->tried[2]; /* copies: trials may take the block away */
        memcpy(small, further(c, program, &m, OUT_SMALL_DRIVES), sizeof(double) * (size_t)k);
        memcpy(small + k, further(c, program, &m, OUT_SMALL_VENOUS), sizeof(double) * (size_t)n);
        memcpy(small + k + n, further(c, program, &m, OUT_END_IMPEDANCE), sizeof(double) * (size_t)k);
        if (!impedances(c, small, small + k)) { /* those of endless elastic tubes, outlets closed */
            memcpy(x + c->Z, small + k + n, sizeof(double) * (size_t)k);
            memset(x + c->Z_0, 0, sizeof(double) * (size_t)k);
            for (int32_t i = 0; i < n; i++) x[c->Z_out + i] = CLOSED;
        }
        x[FOUND] = 1.0;
    }
    const communication_step s = {x[LAST_H], x[LAST_DT], (int64_t)x[LAST_STEPS], program, x + c->now, x + c->last_venous};
    double t;
    const double *const next = trial(c, &s, &t);
    shown_of(c, program, s.parameters, next, t, s.venous, c->answers, c->flows);
    for (int32_t i = 0; i < k; i++) {
        *values++ = c->answers[i] - x[c->Z + i] * next[AT_DRIVE + i] - x[c->Z_0 + i] * x[c->shown + AT_DRIVE + i];
        *values++ = x[c->Z + i];
        *values++ = x[c->Z_0 + i];
    }
    for (int32_t i = 0; i < n; i++) {
        *values++ = s.venous[i] + x[c->Z_out + i] * c->flows[i];
        *values++ = x[c->Z_out + i];
    }
    return 1;
}
