/* Why a step failed, in the sentences of solver/scheme/guards.py. */
#include "component.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Where a margin : (n,) is least; NaN is less than all. */
static int32_t least(const double *margin, int32_t n)
{
    int32_t found = 0;
    for (int32_t i = 1; i < n; i++)
        if ((margin[i] < margin[found] || margin[i] != margin[i]) && margin[found] == margin[found]) found = i;
    return found;
}

static int holds(const double *margin, int32_t n)
{
    for (int32_t i = 0; i < n; i++)
        if (!(margin[i] > 0.0)) return 0;
    return 1;
}

/* "segment CA at x = 3 cm, t = 0.1 s: reason; remedy." of a point. */
static void tell(component *c, int32_t program, const memory *m, int32_t point, double t, const char *reason,
                 const char *remedy)
{
    const int32_t *const segment = c->r.segments + PER_SEGMENT * c->r.elements[point / c->r.meta[N_POINTS]];
    const double x = 100.0 * c->r.positions[point] * value_of(c, segment[VR_L]);
    const int bare = further(c, program, m, OUT_PHI0)[point] == 0.0;
    const char *const number = strchr(reason, '{'), *const rest = number ? strchr(number, '}') : NULL;
    char filled[ROOM / 2];
    if (rest)
        snprintf(filled, sizeof(filled), "%.*s%.3g%s", (int)(number - reason), reason,
                 -0.5 / further(c, program, m, OUT_R)[point], rest + 1);
    snprintf(c->failure, ROOM, "segment %.100s at x = %.3g cm, t = %.6g s: %s; %s%s.", text(c, segment[SEGMENT_NAME]), x, t,
             rest ? filled : reason, remedy, bare ? text(c, c->r.meta[TEXT_SHORTER]) : "");
}

void explain(component *c, int32_t program, const memory *m, int unsolved, double t)
{
    const recorded *const one = &c->r.recorded[program];
    const arterial_program *const p = &one->program;
    const int32_t n = c->r.n_elements * c->r.meta[N_POINTS], per = p->n_Q / c->r.n_elements;
    if (unsolved) run(p, m, END); /* of the last iterate */
    run(p, m, EXPLAIN);
    const double *const lost = further(c, program, m, OUT_LOST);
    for (int32_t i = 0; i < p->n_outlets && unsolved; i++)
        if (lost[i] != 0.0) {
            const int32_t *const segment = c->r.segments + PER_SEGMENT * c->r.venous[PER_VENOUS * i + OUTLET_SEGMENT];
            const char *const name = text(c, segment[SEGMENT_NAME]);
            snprintf(c->failure, ROOM,
                     "segment %.100s at x = %.3g cm, t = %.6g s: the wall at the outlet cannot carry the pressure "
                     "P - P_venous; check %.100s.outlet.P_venous and the elastic law.",
                     name, 100.0 * value_of(c, segment[VR_L]), t, name);
            return;
        }
    for (int32_t i = 0; i < one->meta[N_MARGINS]; i++) {
        double *const margin = further(c, program, m, OUT_MARGINS + i);
        for (int32_t j = 0; j < n && i == 0 && one->meta[N_MARGINS] == MOST_MARGINS; j++)
            if (margin[j] != margin[j]) margin[j] = INFINITY; /* a viscosity that is not known is not to blame */
        if (!holds(margin, n)) {
            tell(c, program, m, least(margin, n), t, text(c, one->reasons[2 * i]), text(c, one->reasons[2 * i + 1]));
            return;
        }
    }
    const double *const Q = placed(m, p->place[IN_Q]), *const before = last_but_one(p, m);
    const double *const A0 = further(c, program, m, OUT_A0);
    double worst = -1.0;
    int32_t at = 0;
    for (int32_t e = 0; e < c->r.n_elements; e++) {
        double change = 0.0;
        for (int32_t k = e * per; k < (e + 1) * per; k++) change = fmax(change, fabs(Q[k] - before[k]));
        for (int32_t j = e * c->r.meta[N_POINTS]; j < (e + 1) * c->r.meta[N_POINTS]; j++)
            if (change / A0[j] > worst) {
                worst = change / A0[j];
                at = j;
            }
    }
    const char *const unsolved_text = text(c, c->r.meta[TEXT_UNSOLVED]);
    tell(c, program, m, at, t, unsolved_text, unsolved_text + strlen(unsolved_text) + 1);
}
