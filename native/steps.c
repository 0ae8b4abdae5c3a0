/* Implicit steps: stages of the SDIRK method, and the chord iteration that solves each, as solver/scheme/step.py and
   stage.py do it. What a step leaves unsolved is left to them. */
#include "engine.h"
#include "run.h"

#include <math.h>
#include <string.h>

enum { CORRECTIONS = 8, REFRESHES = 5 };

#define GAMMA 0.43586652150845967
const double SDIRK3[STAGES][STAGES] = {
    {GAMMA, 0.0, 0.0},
    {(1.0 - GAMMA) / 2.0, GAMMA, 0.0},
    {-1.5 * GAMMA * GAMMA + 4.0 * GAMMA - 0.25, 1.5 * GAMMA * GAMMA - 5.0 * GAMMA + 1.25, GAMMA},
};

double *place(const arterial_program *p, const memory *m, int which)
{
    return placed(m, p->place[which]);
}

double *last_but_one(const arterial_program *p, const memory *m)
{
    return m->work + p->n_work + STAGES * p->n_y + p->n_Q + p->n_H;
}

void put(const arterial_program *p, const memory *m, int which, const double *x, int32_t n)
{
    memcpy(place(p, m, which), x, sizeof(double) * (size_t)n);
}

memory memory_of(const arterial_program *p, const double *fixed, double *work)
{
    const memory m = {p->constant, (double *)fixed, work, p->index, 0};
    return m;
}

int arterial_bind(const arterial_program *p, double *fixed, double *work)
{
    const memory m = memory_of(p, fixed, work);
    return run(p, &m, BIND);
}

int32_t arterial_state_size(const arterial_program *p)
{
    return p->n_y + p->n_A + p->n_H + 2 * STAGES * (p->n_Q + p->n_H);
}

/* Chord iterations with one Jacobian, on the iterate in its place. Returns 1 when solved, 0 when not; moved : whether the
   last one was finite. guess : where the first iterate is kept if the second one is not the solution, or null. */
static int iterate(const arterial_program *p, const memory *m, int fresh, int *moved, double *guess)
{
    const int phase = fresh ? CORRECT_FRESH : CORRECT, out = fresh ? FRESH_Q : OUT_Q;
    const double small_Q = *place(p, m, OUT_SMALL_Q), small_H = *place(p, m, OUT_SMALL_H);
    double *const H = place(p, m, IN_H);
    for (int k = 0; k < CORRECTIONS; k++) {
        *moved = run(p, m, phase);
        const double *const dH = place(p, m, out + 1), Q_by = *place(p, m, out + 2), H_by = *place(p, m, out + 3);
        *moved = *moved && isfinite(Q_by) && isfinite(H_by);
        const int done = *moved && Q_by <= small_Q && H_by <= small_H;
        if (guess && !k && !done) {
            memcpy(guess, place(p, m, IN_Q), sizeof(double) * (size_t)p->n_Q);
            memcpy(guess + p->n_Q, H, sizeof(double) * (size_t)p->n_H);
        }
        if (!*moved) return 0;
        if (!done) memcpy(last_but_one(p, m), place(p, m, IN_Q), sizeof(double) * (size_t)p->n_Q);
        put(p, m, IN_Q, place(p, m, out), p->n_Q);
        for (int32_t i = 0; i < p->n_H; i++) H[i] += dH[i];
        if (done) return 1;
    }
    return 0;
}

int solve(const arterial_program *p, const memory *m, double *guess)
{
    int moved = 1;
    if (iterate(p, m, 0, &moved, guess)) return 1;
    for (int k = 0; k < REFRESHES; k++) {
        if (!run(p, m, FINITE)) return 0;
        if (!moved || *place(p, m, OUT_FINITE) == 0.0) { /* thrown off: from the guess again */
            put(p, m, IN_Q, guess, p->n_Q);
            put(p, m, IN_H, guess + p->n_Q, p->n_H);
        }
        if (!run(p, m, REFRESH)) return 0;
        if (iterate(p, m, 1, &moved, 0)) return 1;
    }
    return 0;
}

int step(const arterial_program *p, const memory *m, double dt, const double *state, double *after, const double *acting)
{
    const int32_t n = p->n_y, unknowns = p->n_Q + p->n_H;
    const double *const last = state + n + p->n_A + p->n_H, *const before = last + STAGES * unknowns;
    const double tau = GAMMA * dt;
    double *const k = m->work + p->n_work, *const guess = k + STAGES * n;
    double *const Q = place(p, m, IN_Q), *const H = place(p, m, IN_H);
    double *const found = after + n + p->n_A + p->n_H, *const start = place(p, m, IN_START);
    const double *const begun = place(p, m, OUT_BEGUN);
    int32_t i;
    put(p, m, IN_Y, state, n);
    put(p, m, IN_H0, state + n + p->n_A, p->n_H);
    put(p, m, IN_G_BEGIN, acting, p->n_sources);
    if (!run(p, m, PREPARE)) return 0;
    memcpy(found + STAGES * unknowns, last, sizeof(double) * STAGES * (size_t)unknowns);
    for (int s = 0; s < STAGES; s++) {
        double *const k_s = k + s * n, *const rates = found + s * unknowns;
        const double a = dt * SDIRK3[s][0], b = dt * SDIRK3[s][1];
        for (i = 0; i < n; i++) start[i] = s == 0 ? begun[i] : s == 1 ? begun[i] + a * k[i] : (begun[i] + a * k[i]) + b * k[n + i];
        put(p, m, IN_GIVEN, place(p, m, OUT_GIVEN) + s * p->n_inlets, p->n_inlets);
        put(p, m, IN_G, acting + (s + 1) * p->n_sources, p->n_sources);
        if (!run(p, m, START)) return 0;
        for (i = 0; i < unknowns; i++) rates[i] = 2.0 * last[s * unknowns + i] - before[s * unknowns + i];
        for (i = 0; i < p->n_Q; i++) Q[i] = start[p->at_Q + i] + tau * rates[i];
        memcpy(H, rates + p->n_Q, sizeof(double) * (size_t)p->n_H);
        if (!solve(p, m, guess) || !run(p, m, END)) return 0;
        const double *const end = place(p, m, OUT_END), *const A_t = place(p, m, OUT_A_T);
        if (s < STAGES - 1) { /* for the stages behind it */
            memcpy(k_s, A_t, sizeof(double) * (size_t)p->n_A); /* without the round-off of the difference */
            for (i = p->n_A; i < n; i++) k_s[i] = (end[i] - start[i]) / tau;
        }
        for (i = 0; i < p->n_Q; i++) rates[i] = (end[p->at_Q + i] - start[p->at_Q + i]) / tau;
        memcpy(rates + p->n_Q, H, sizeof(double) * (size_t)p->n_H);
    }
    if (!run(p, m, CHECK)) return 0;
    if (!(*place(p, m, OUT_MARGIN) > 0.0)) return -1;
    memcpy(after, place(p, m, OUT_END), sizeof(double) * (size_t)n);
    memcpy(after + n, place(p, m, OUT_A_T), sizeof(double) * (size_t)p->n_A);
    memcpy(after + n + p->n_A, H, sizeof(double) * (size_t)p->n_H);
    return 1;
}

void report(const arterial_program *p, const memory *m, const double *state, double *row, const double *acting)
{
    put(p, m, IN_G_REPORT, acting, p->n_sources);
    put(p, m, IN_Y_REPORT, state, p->n_y);
    put(p, m, IN_A_T_REPORT, state + p->n_y, p->n_A);
    put(p, m, IN_H_REPORT, state + p->n_y + p->n_A, p->n_H);
    run(p, m, REPORT);
    memcpy(row, place(p, m, OUT_REPORT), sizeof(double) * (size_t)p->n_report);
}

int32_t arterial_steps(const arterial_program *p, int32_t n, int32_t B, double dt, const double *fixed, double *state,
                       double *spare, double *work, const double *drive, int own_drive, const double *venous,
                       const double *acting, double *table)
{
    const int32_t size = arterial_state_size(p), columns = 4 * p->n_inlets, D = own_drive ? B : 1;
    const size_t bytes = sizeof(double) * (size_t)B * (size_t)size;
    double *const given_state = state, *other;
    int32_t i;
    for (i = 0; i < n; i++) {
        int32_t b;
        for (b = 0; b < B; b++) {
            const memory m = memory_of(p, fixed + (int64_t)b * p->n_fixed, work);
            double *const from = state + (int64_t)b * size, *const to = spare + (int64_t)b * size;
            const double *const given = drive + (int64_t)i * columns * D + (own_drive ? b : 0);
            for (int32_t j = 0; j < columns; j++) place(p, &m, IN_DRIVE)[j] = given[(int64_t)j * D];
            put(p, &m, IN_VENOUS, venous + (int64_t)b * p->n_outlets, p->n_outlets);
            const double *const now = acting + (int64_t)i * (STAGES + 1) * p->n_sources;
            if (step(p, &m, dt, from, to, now) <= 0) break;
            report(p, &m, to, table + ((int64_t)i * B + b) * p->n_report, now + STAGES * p->n_sources);
        }
        if (b < B) break;
        other = state;
        state = spare;
        spare = other;
    }
    if (state != given_state) memcpy(given_state, state, bytes);
    return i;
}
