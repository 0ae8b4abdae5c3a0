/* Directional derivatives of a communication step: the step is made again from where it began, and behind each internal
   step its derivative, which solver/tracing/derivative.py has recorded: of what a stage solves, by the Jacobian where it
   ended. For hearts and bodies one program does both. */
#include "component.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { D_PARAMETERS, D_DT, D_LENGTH, D_Y, D_H0, D_DRIVE, D_VENOUS, D_G_BEGIN, D_START, D_GIVEN_NOW, D_G, D_Q, D_H,
       D_R_LEFT, D_NET_LEFT, D_Y_REPORT, D_A_T_REPORT, D_H_REPORT, D_G_REPORT, D_BEGUN, D_GIVEN, D_END, D_A_T,
       D_Q_CHANGE, D_H_CHANGE,
       BY_PARAMETERS, BY_Y, BY_DRIVE, BY_VENOUS, BY_START, BY_GIVEN_NOW, BY_Q, BY_Y_REPORT, BY_A_T_REPORT,
       BY_H_REPORT, /* directions that are given */
       BY_BEGUN, BY_GIVEN, BY_R, BY_NET, BY_END, BY_A_T, BY_REPORT, BY_V }; /* and found; D_PLACES of them */
enum { SOLVE = PHASES }; /* the phase after those of a step */

/* Of the direction of a position: y, dA/dt, H and what has come in. */
struct derivative {
    double *seed, *kept, *fixed, *work, *known, *shown, *at, *start, *end, *drives[HALVINGS + 2], *k, *by_k, *row;
    const recorded *of; /* whose derivatives they are */
    double dt;          /* of the coefficients in fixed, and what they are of */
    const double *parameters;
    int acts, acted; /* whether parameters and P_venous have their directions, now and in fixed */
};

/* The program that has derivatives: of hearts and bodies the last one; of arteries that of the laws at hand whose walls
   may be nonlinear, and so serves all. */
static const recorded *with_derivatives(const component *c)
{
    const int32_t *const meta = c->r.meta;
    if (meta[N_ARITHMETIC]) return &c->r.recorded[DERIVES];
    for (int32_t i = meta[N_PROGRAMS] - 1; i >= 0; i--) {
        const recorded *const one = &c->r.recorded[i];
        if (one->derived_places && one->meta[ELASTIC] == (int32_t)value_of(c, meta[VR_ELASTIC]) &&
            one->meta[VISCOUS] == (int32_t)value_of(c, meta[VR_VISCOUS]))
            return one;
    }
    return NULL;
}

static double *at(const struct derivative *d, int which)
{
    const memory m = memory_of(&d->of->derived, d->fixed, d->work);
    return placed(&m, d->of->derived_places[which]);
}

/* Puts n numbers; NULL for zeros. */
static void give(const struct derivative *d, int which, const double *x, int64_t n)
{
    if (x) memcpy(at(d, which), x, sizeof(double) * (size_t)n);
    else memset(at(d, which), 0, sizeof(double) * (size_t)n);
}

static int runs(const struct derivative *d, int phase)
{
    const memory m = memory_of(&d->of->derived, d->fixed, d->work);
    return run(&d->of->derived, &m, phase);
}

static int coefficients(component *c, const double *parameters, double dt)
{
    struct derivative *const d = c->d;
    const double length = value_of(c, c->r.meta[VR_LENGTH]);
    if (d->dt == dt && d->parameters == parameters && d->acted == d->acts) return 1;
    memset(d->fixed, 0, sizeof(double) * (size_t)d->of->derived.n_fixed);
    give(d, D_PARAMETERS, parameters, c->r.n_parameters);
    give(d, D_DT, &dt, 1);
    give(d, D_LENGTH, &length, 1);
    for (int32_t i = 0; i < c->r.n_parameters && d->acts; i++) at(d, BY_PARAMETERS)[i] = d->seed[c->r.parameters[i]];
    if (!runs(d, BIND)) return 0;
    d->dt = dt;
    d->parameters = parameters;
    d->acted = d->acts;
    return 1;
}

int derivative_step(component *c, const communication_step *s, double t, double dt, int depth, int own)
{
    struct derivative *const d = c->d;
    const arterial_program *const q = &d->of->program;
    const int32_t n = q->n_y, n_Q = q->n_Q, n_H = q->n_H, n_in = q->n_inlets, n_g = q->n_sources;
    const double tau = SDIRK3[0][0] * dt, *const acting = acting_at(c, t, dt);
    const double *const solved = c->after + n + q->n_A + n_H;
    if (!coefficients(c, s->parameters, dt)) return 0;
#define AT(which) at(d, which)
#define GIVE(which, x, n) give(d, which, x, n)
    GIVE(D_Y, c->spare, n);
    GIVE(D_H0, c->spare + n + q->n_A, n_H);
    GIVE(D_DRIVE, c->drives[depth], 4 * n_in);
    GIVE(D_VENOUS, s->venous, q->n_outlets);
    GIVE(D_G_BEGIN, acting, n_g);
    GIVE(BY_Y, d->at, n);
    GIVE(BY_DRIVE, d->drives[depth], 4 * n_in);
    for (int32_t i = 0; i < q->n_outlets; i++)
        AT(BY_VENOUS)[i] = d->acts ? d->seed[c->r.venous[PER_VENOUS * i + VR_VENOUS]] : 0.0;
    if (!runs(d, PREPARE)) return 0;
    for (int stage = 0; stage < STAGES; stage++) {
        const double *const found = solved + stage * (n_Q + n_H);
        double *const k = d->k + stage * n, *const by_k = d->by_k + stage * n, *const Q = AT(D_Q);
        GIVE(D_START, AT(D_BEGUN), n);
        GIVE(BY_START, AT(BY_BEGUN), n);
        for (int j = 0; j < stage; j++)
            for (int32_t i = 0; i < n; i++) {
                AT(D_START)[i] += dt * SDIRK3[stage][j] * d->k[j * n + i];
                AT(BY_START)[i] += dt * SDIRK3[stage][j] * d->by_k[j * n + i];
            }
        GIVE(D_GIVEN_NOW, AT(D_GIVEN) + stage * n_in, n_in);
        GIVE(BY_GIVEN_NOW, AT(BY_GIVEN) + stage * n_in, n_in);
        GIVE(D_G, acting + (stage + 1) * n_g, n_g);
        for (int32_t i = 0; i < n_Q; i++) Q[i] = AT(D_START)[q->at_Q + i] + tau * found[i];
        GIVE(D_H, found + n_Q, n_H);
        if (!runs(d, START) || !runs(d, CORRECT)) return 0;
        GIVE(D_R_LEFT, AT(BY_R), n_Q);
        GIVE(D_NET_LEFT, AT(BY_NET), n_H);
        if (!runs(d, SOLVE)) return 0;
        GIVE(BY_Q, AT(D_Q_CHANGE), n_Q);
        if (!runs(d, END)) return 0;
        for (int32_t i = 0; i < n; i++) {
            k[i] = i < q->n_A ? AT(D_A_T)[i] : (AT(D_END)[i] - AT(D_START)[i]) / tau;
            by_k[i] = i < q->n_A ? AT(BY_A_T)[i] : (AT(BY_END)[i] - AT(BY_START)[i]) / tau;
        }
    }
    double *const come = d->at + n + q->n_A + n_H;
    for (int32_t i = 0; i < n_in; i++) {
        if (!own && c->r.inlets[PER_INLET * i + BY_FLOW]) continue;
        const int32_t column = d->of->first[i];
        for (int stage = 0; stage < STAGES; stage++) {
            double Q = AT(BY_BEGUN)[column];
            for (int j = 0; j < STAGES; j++) Q += dt * SDIRK3[stage][j] * d->by_k[j * n + column];
            *come += dt * SDIRK3[STAGES - 1][stage] * Q;
        }
    }
    memcpy(d->at, AT(BY_END), sizeof(double) * (size_t)n);
    memcpy(d->at + n, AT(BY_A_T), sizeof(double) * (size_t)q->n_A);
    memcpy(d->at + n + q->n_A, AT(D_H_CHANGE), sizeof(double) * (size_t)n_H);
    return 1;
}

void derivative_drive(component *c, int64_t k, int64_t steps)
{
    static const double TIMES[4] = {0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0};
    struct derivative *const d = c->d;
    for (int32_t i = 0; i < c->r.n_inlets; i++)
        for (int j = 0; j < 4; j++)
            d->drives[0][4 * i + j] = steps ? d->start[i] + ((double)k + TIMES[j]) * (d->end[i] - d->start[i]) / (double)steps : 0.0;
}

void derivative_half(component *c, int half, int depth)
{
    half_of(c->d->drives[depth], c->r.n_inlets, half, c->d->drives[depth + 1]);
}

/* Outputs and volume of a position in the direction that is in at; without it, NULL, by parameters alone. */
static int shown_by(component *c, const double *position, const double *by)
{
    struct derivative *const d = c->d;
    const arterial_program *const q = &d->of->program;
    const double *const state = position + AT_DRIVE + c->r.n_inlets;
    if (!coefficients(c, c->numbers + c->now, c->numbers[LAST_DT])) return 0;
    const int32_t from[] = {0, q->n_y, q->n_y + q->n_A}, n[] = {q->n_y, q->n_A, q->n_H};
    for (int i = 0; i < 3; i++) {
        give(d, D_Y_REPORT + i, state + from[i], n[i]);
        give(d, BY_Y_REPORT + i, by ? by + from[i] : NULL, n[i]);
    }
    give(d, D_G_REPORT, acting_at(c, c->numbers[TIME], 0.0), q->n_sources);
    if (!runs(d, REPORT)) return 0;
    memcpy(d->row, at(d, BY_REPORT), sizeof(double) * (size_t)q->n_report);
    d->row[q->n_report] = *at(d, BY_V);
    return 1;
}

int derivative_begins(component *c, const double *position, int which, int acts, double start, double end)
{
    struct derivative *const d = c->d;
    const arterial_program *const q = &d->of->program;
    const int32_t size = q->n_y + q->n_A + q->n_H;
    if (which == KNOWN_AS_SHOWN) memcpy(d->shown, d->known, sizeof(double) * (size_t)(size + 1));
    d->at = which == KNOWN ? d->known : d->shown;
    d->acts = acts;
    for (int32_t i = 0; i < c->r.n_inlets; i++) {
        d->start[i] = start * d->seed[c->r.inlets[PER_INLET * i + VR_INLET]];
        d->end[i] = end * d->seed[c->r.inlets[PER_INLET * i + VR_INLET]];
    }
    if (!acts) return 1;
    if (!shown_by(c, position, NULL)) return 0; /* what another compliance holds counts as come in */
    d->at[size] += d->row[q->n_report];
    return 1;
}

void derivative_came(component *c, double time)
{
    const arterial_program *const q = &c->d->of->program;
    for (int32_t i = 0; i < c->r.n_inlets; i++)
        if (c->r.inlets[PER_INLET * i + BY_FLOW])
            c->d->at[q->n_y + q->n_A + q->n_H] += 0.5 * time * (c->d->start[i] + c->d->end[i]);
}

/* --- what hosts ask for ------------------------------------------------------------------------------------------------ */

static struct derivative *made(const component *c)
{
    const resource *const r = &c->r;
    const int64_t n = r->meta[N_VARIABLES], n_in = r->n_inlets;
    int64_t fixed = 0, work = 0, y = 0, size = 0, row = 0;
#define MORE(of, than) of = (than) > of ? (than) : of
    for (int32_t i = 0; i < r->meta[N_PROGRAMS]; i++) {
        const arterial_program *const p = &r->recorded[i].derived, *const q = &r->recorded[i].program;
        MORE(fixed, p->n_fixed);
        MORE(work, p->n_work);
        MORE(y, q->n_y);
        MORE(size, q->n_y + q->n_A + q->n_H + 1);
        MORE(row, q->n_report + 1);
    }
    const int64_t all = n + c->n_numbers + fixed + work + 2 * size + 2 * n_in + 4 * n_in * (HALVINGS + 2) + 6 * y + row;
    struct derivative *const d = calloc(1, sizeof(struct derivative) + sizeof(double) * (size_t)all);
    if (!d) return NULL;
    double *next = (double *)(d + 1);
#define TAKE(name, count) d->name = next, next += (count)
    TAKE(seed, n), TAKE(kept, c->n_numbers), TAKE(fixed, fixed), TAKE(work, work), TAKE(known, size), TAKE(shown, size);
    TAKE(start, n_in), TAKE(end, n_in), TAKE(k, 3 * y), TAKE(by_k, 3 * y), TAKE(row, row);
    for (int i = 0; i < HALVINGS + 2; i++) TAKE(drives[i], 4 * n_in);
    return d;
}

/* The step of arteries made again, with the directions of all outputs that are not late in their place. */
static int derived(component *c, struct derivative *d, double t, double h)
{
    const arterial_program *const q = &d->of->program;
    const int64_t size = q->n_y + q->n_A + q->n_H;
    memset(d->known, 0, sizeof(double) * (size_t)(size + 1));
    memset(d->shown, 0, sizeof(double) * (size_t)(size + 1));
    d->dt = 0.0;
    c->d = d;
    const int done = component_again(c, t, h) && shown_by(c, c->numbers + c->shown, d->shown);
    c->d = NULL;
    if (!done) return say(c, "the step cannot be made again.");
    double *const found = c->numbers + c->values + c->r.meta[FIRST_OUTPUT];
    memcpy(found, d->row, sizeof(double) * (size_t)(q->n_report + 1)); /* the last one is the volume's */
    found[q->n_report + 1] = d->shown[size] - d->row[q->n_report];
    found[q->n_report + 2] = found[q->n_report + 1] / h;
    return 1;
}

int component_derivative(component *c, const uint32_t *unknown, size_t n, const uint32_t *known, size_t m,
                         const double *seed, double *found)
{
    const int32_t *const meta = c->r.meta;
    if (c->numbers[STATE_OF] != STEPPING || !c->stepped)
        return say(c, "directional derivatives are those of the last step: make one, after a state was restored, too.");
    const recorded *const of = with_derivatives(c);
    if (!of)
        return say(c, "this FMU holds no derivatives for network.elastic_law as it is set; build it anew with --set.");
    for (size_t i = 0; i < n; i++)
        if (unknown[i] < (uint32_t)meta[FIRST_OUTPUT] || unknown[i] >= (uint32_t)meta[FIRST_LATE])
            return say(c, "value reference %ld: has no directional derivative; outputs have but those of ports.", (long)unknown[i]);
    for (size_t i = 0; i < m; i++) {
        const int32_t *const v = known[i] < (uint32_t)meta[N_VARIABLES] ? variable(c, known[i]) : NULL;
        if (!v || v[KIND] != REAL || v[CAUSALITY] == OUTPUT || v[VARIABILITY] == FIXED)
            return say(c, "value reference %ld: there are derivatives by inputs and tunable parameters.", (long)known[i]);
    }
    if (!c->derivative && !(c->derivative = made(c))) return say(c, "no memory.");
    struct derivative *const d = c->derivative;
    const double h = c->numbers[LAST_H];
    d->of = of;
    memset(d->seed, 0, sizeof(double) * (size_t)meta[N_VARIABLES]);
    for (size_t i = 0; i < m; i++) d->seed[known[i]] += seed[i];
    memcpy(d->kept, c->numbers, sizeof(double) * (size_t)c->n_numbers);
    memcpy(c->numbers, c->before, step_bytes(c));
    const int done = meta[N_ARITHMETIC] ? arithmetic_derived(c, c->before[TIME], h, d->seed)
                                        : derived(c, d, c->before[TIME], h);
    for (size_t i = 0; i < n && done; i++) found[i] = value_of(c, (int32_t)unknown[i]);
    memcpy(c->numbers, d->kept, sizeof(double) * (size_t)c->n_numbers);
    return done;
}
