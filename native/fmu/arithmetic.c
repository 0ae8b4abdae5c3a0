/* Components without extent, hearts and bodies: their programs, as solver/tracing/arithmetic.py records them. */
#include "component.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* A sentence, in which %g and %.6g stand for numbers at places, %% for a %; the builder of the resource admits no other. */
static int told(component *c, const memory *m, const char *s, const int32_t *places)
{
    const int32_t *const end = places + PER_REQUIREMENT - FIRST_NUMBER;
    for (size_t at = 0; *s && at < ROOM - 64; c->said[at] = 0) {
        char format[8] = "";
        size_t n = *s == '%' ? 2 + strspn(s + 1, ".0123456789") : 0;
        if (n && n < sizeof(format) && s[n - 1] == 'g' && places < end) {
            memcpy(format, s, n);
            snprintf(c->said + at, 64, format, *placed(m, *places++));
            at += strlen(c->said + at);
        } else {
            n = s[0] == '%' && s[1] == '%' ? 2 : 1;
            c->said[at++] = *s;
        }
        s += n;
    }
    return 0;
}

/* What must be true after a phase. */
static int fulfilled(component *c, const memory *m, const int32_t *requirement, int32_t n, int32_t phase)
{
    for (int32_t i = 0; i < n; i++, requirement += PER_REQUIREMENT)
        if (requirement[REQUIRED_IN] == phase && !(*placed(m, requirement[CONDITION]) != 0.0))
            return told(c, m, text(c, requirement[SENTENCE]), requirement + FIRST_NUMBER);
    return 1;
}

/* Runs a program, of a step from t of length h: from values, of which some may have a direction, and state to state and
   outputs. */
static int done(component *c, int which, double t, double h, const double *direction)
{
    const recorded *const one = &c->r.recorded[which];
    const int32_t *const meta = one->meta, *loop = meta + A_HEAD, *const requirements = loop + PER_LOOP * meta[N_LOOPS];
    const memory m = memory_of(&one->program, c->slots[0].fixed, c->work);
    double *const x = c->numbers, *const state = x + c->shown + AT_DRIVE;
    const double *const given[] = {x + c->values, state, &t, &h, direction};
    const size_t n = (size_t)c->r.meta[FIRST_OUTPUT], sizes[] = {n, (size_t)c->r.n_state, 1, 1, n};
    for (int i = 0; i < 5; i++)
        if (meta[GIVEN_VALUES + i] >= 0) memcpy(placed(&m, meta[GIVEN_VALUES + i]), given[i], sizeof(double) * sizes[i]);
    for (int32_t phase = 0; phase <= 2 * meta[N_LOOPS]; phase++) {
        if (phase % 2) {
            const size_t bytes = sizeof(double) * (size_t)loop[LOOP_SIZE];
            double *const going = placed(&m, loop[LOOP_BEFORE]);
            memcpy(going, placed(&m, loop[LOOP_BEGIN]), bytes);
            for (; *going > 0.0; memcpy(going, placed(&m, loop[LOOP_AFTER]), bytes)) run(&one->program, &m, phase);
            loop += PER_LOOP;
        } else {
            run(&one->program, &m, phase);
        }
        if (!fulfilled(c, &m, requirements, meta[N_REQUIREMENTS], phase)) return 0;
    }
    memcpy(state, placed(&m, meta[NEXT_STATE]), sizeof(double) * (size_t)c->r.n_state);
    memcpy(x + c->values + c->r.meta[FIRST_OUTPUT], placed(&m, meta[OUTPUTS]),
           sizeof(double) * (size_t)(c->r.meta[N_VARIABLES] - c->r.meta[FIRST_OUTPUT]));
    x[TIME] = t + h;
    return outputs_are_finite(c);
}

int arithmetic_initialized(component *c)
{
    if (!done(c, BEGINS, c->numbers[T0], 0.0, NULL)) return 0;
    c->numbers[READY] = 1.0;
    c->numbers[OUTDATED] = 0.0;
    return 1;
}

int arithmetic_stepped(component *c, double t, double h)
{
    if (!begins_here(c, t, h, 2e-9) || !done(c, STEPS, t, h, NULL)) return 0;
    c->numbers[CHANGED] = 0.0;
    c->numbers[LAST_H] = h;
    return 1;
}

int arithmetic_derived(component *c, double t, double h, const double *direction)
{
    return done(c, DERIVES, t, h, direction) || say(c, "directional derivatives: some are not finite; give a smaller seed.");
}

/* The places of a program; 0 where they are not whole. */
int arithmetic_read(const resource *r, const recorded *one, int32_t n, int32_t n_begin)
{
    const int32_t *const meta = one->meta;
    return r->meta[N_PROGRAMS] == A_PROGRAMS && r->n_inlets == 0 && r->n_outlets == 0 && n >= A_HEAD &&
           meta[N_LOOPS] >= 0 && meta[N_REQUIREMENTS] >= 0 &&
           n == A_HEAD + PER_LOOP * meta[N_LOOPS] + PER_REQUIREMENT * meta[N_REQUIREMENTS] && n_begin == 2 * meta[N_LOOPS] + 2;
}
