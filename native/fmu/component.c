/* The component: its phases, its values, its communication steps, as fmu_src/slaves/base.py and cosimulation/arteries.py
   have them. */
#include "component.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const NAMES[] = {"instantiated", "initialization mode", "stepping", "terminated"};
static const double FURTHEST = 2.0, RENEWED = 9.9e-3, SLACK = 2e-6, MOST_STEPS = 1e6;

int say(component *c, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(c->said, ROOM, format, arguments);
    va_end(arguments);
    return 0;
}

const char *component_said(const component *c) { return c->said; }

const char *text(const component *c, int32_t at) { return c->r.strings + at; }

double value_of(const component *c, int32_t vr) { return c->numbers[c->values + vr]; }

const int32_t *variable(const component *c, uint32_t vr) { return c->r.variables + PER_VARIABLE * (size_t)vr; }

const char *name_of(const component *c, uint32_t vr) { return text(c, variable(c, vr)[NAME]); }

/* --- made and reset ---------------------------------------------------------------------------------------------------- */

/* The next n numbers of a block that is being counted, or laid out. */
static double *taken(double **at, int64_t n)
{
    double *const found = *at;
    *at += n;
    return found;
}

/* Lays out all memory from a place on; returns where it ends. With from = NULL it only counts. */
static size_t laid_out(component *c, double *from)
{
    const resource *const r = &c->r;
    const int64_t n_in = r->n_inlets, n_out = r->n_outlets;
    int64_t n = N_HEAD, work = 0, fixed = 0, rows = 0;
#define PLACE(name, count) c->name = n, n += (count)
    c->n_position = AT_DRIVE + n_in + r->n_state;
    PLACE(values, r->meta[N_VARIABLES]);
    PLACE(now, r->n_parameters);
    PLACE(slope, n_in);
    PLACE(unset, n_in);
    PLACE(last_venous, n_out);
    PLACE(shown, c->n_position);
    PLACE(known, c->n_position);
    PLACE(basis_venous, n_out);
    PLACE(Z, n_in);
    PLACE(Z_0, n_in);
    PLACE(Z_out, n_out);
    PLACE(basis_known, c->n_position);
    PLACE(basis_shown, c->n_position);
    c->n_numbers = n;
    for (int32_t i = 0; i < r->meta[N_PROGRAMS]; i++) {
        const arterial_program *const p = &r->recorded[i].program;
        const int64_t needs = p->n_work + 3 * (int64_t)p->n_y + 2 * p->n_Q + p->n_H;
        work = needs > work ? needs : work;
        fixed = p->n_fixed > fixed ? p->n_fixed : fixed;
        rows = p->n_report > rows ? p->n_report : rows;
    }
    double *at = from;
    if (!from) {
        const int64_t per_slot = r->n_parameters + fixed;
        return sizeof(double) * (size_t)(2 * n + 3 * c->n_position + 2 * r->n_state + work + rows + 2 * n_in + 2 * n_out +
                                         4 * r->n_sources + 1 + 3 * n_in + 4 * n_in * (HALVINGS + 2) + n_out + SLOTS * per_slot);
    }
    c->numbers = taken(&at, n);
    c->before = taken(&at, n);
    for (int i = 0; i < 3; i++) c->tried[i] = taken(&at, c->n_position);
    c->spare = taken(&at, r->n_state);
    c->after = taken(&at, r->n_state);
    c->work = taken(&at, work);
    c->row = taken(&at, rows);
    c->answers = taken(&at, 2 * n_in);
    c->flows = taken(&at, 2 * n_out);
    c->given = taken(&at, 3 * n_in);
    for (int i = 0; i < HALVINGS + 2; i++) c->drives[i] = taken(&at, 4 * n_in);
    c->pressures = taken(&at, n_out);
    c->acting = taken(&at, (STAGES + 1) * r->n_sources + 1);
    for (int i = 0; i < SLOTS; i++) {
        c->slots[i].parameters = taken(&at, r->n_parameters);
        c->slots[i].fixed = taken(&at, fixed);
    }
    return 0;
}

component *component_new(const char *folder, const char *guid, char *why, size_t room)
{
    component *const c = calloc(1, sizeof(component));
    if (!c) return snprintf(why, room, "no memory."), NULL;
    if (!resource_read(&c->r, folder, why, room)) return free(c), NULL;
    double *block = NULL;
    if (strcmp(guid, c->r.guid))
        snprintf(why, room, "the GUID %.80s is not that of this FMU, %.80s; give the one of its modelDescription.xml.",
                 guid, c->r.guid);
    else if (!(block = calloc(1, laid_out(c, NULL))))
        snprintf(why, room, "no memory.");
    if (!block) return resource_free(&c->r), free(c), NULL;
    laid_out(c, block);
    component_reset(c);
    return c;
}

void component_free(component *c)
{
    free(c->numbers);
    resource_free(&c->r);
    free(c->derivative);
    free(c);
}

void component_reset(component *c)
{
    c->stepped = 0;
    memset(c->numbers, 0, sizeof(double) * (size_t)c->n_numbers);
    for (int32_t i = 0; i < c->r.meta[N_VARIABLES]; i++)
        c->numbers[c->values + i] = i < c->r.meta[FIRST_OUTPUT] ? c->r.ranges[PER_RANGE * i + START_VALUE] : 0.0;
    c->numbers[OUTDATED] = 1.0;
}

int component_may_be(const component *c, const double *numbers)
{
    const double steps[] = {numbers[LAST_STEPS], numbers[BASIS_STEPS]};
    for (int i = 0; i < 2; i++)
        if (!(steps[i] >= 0.0 && steps[i] <= MOST_STEPS)) return 0;
    for (int32_t i = 0; i < c->r.meta[N_VARIABLES]; i++) {
        const int32_t *const v = variable(c, (uint32_t)i);
        const double value = numbers[c->values + i];
        if (v[KIND] == ENUMERATION && !(value >= 1.0 && value <= v[CHOICES])) return 0;
    }
    return numbers[NOW] >= 0.0 && numbers[NOW] < c->r.meta[N_PROGRAMS] && numbers[STATE_OF] >= INSTANTIATED &&
           numbers[STATE_OF] <= TERMINATED;
}

/* --- phases ----------------------------------------------------------------------------------------------------------- */

static int require(component *c, const char *call, int phase)
{
    const int now = (int)c->numbers[STATE_OF];
    if (now == phase) return 1;
    return say(c, "%s in phase '%s': it belongs to phase '%s'; reset the component.", call, NAMES[now], NAMES[phase]);
}

int component_set_up(component *c, double start, int has_stop, double stop)
{
    if (!require(c, "setup_experiment", INSTANTIATED)) return 0;
    if (!isfinite(start)) return say(c, "start time of %g s: must be finite.", start);
    if (has_stop && !(stop >= start))
        return say(c, "stop time of %g s: must not lie before the start time of %g s.", stop, start);
    c->numbers[T0] = start;
    c->numbers[HAS_STOP] = has_stop ? 1.0 : 0.0;
    c->numbers[STOP] = has_stop ? stop : 0.0;
    return 1;
}

int component_enter(component *c)
{
    if (!require(c, "enter_initialization_mode", INSTANTIATED)) return 0;
    c->numbers[STATE_OF] = INITIALIZING;
    return 1;
}

void keep(component *c) { memcpy(c->before, c->numbers, sizeof(double) * (size_t)c->n_numbers); }

int back(component *c)
{
    memcpy(c->numbers, c->before, sizeof(double) * (size_t)c->n_numbers);
    return 0;
}

/* --- communication steps ------------------------------------------------------------------------------------------------ */

static void driving(const component *c, double *found)
{
    for (int32_t i = 0; i < c->r.n_inlets; i++) found[i] = value_of(c, c->r.inlets[PER_INLET * i + VR_INLET]);
}

static int same(const double *a, const double *b, int32_t n)
{
    for (int32_t i = 0; i < n; i++)
        if (a[i] != b[i]) return 0;
    return 1;
}

static double volume(component *c, const double *parameters, int32_t program, const double *position)
{
    return shown_of(c, program, parameters, position, 0.0, c->numbers + c->last_venous, NULL, NULL);
}

/* The same position under other parameters. What another compliance holds at the same pressure counts as come in. */
static void under(component *c, double *position)
{
    position[V_IN] += volume(c, c->numbers + c->now, (int32_t)c->numbers[NOW], position) -
                      volume(c, c->before + c->now, (int32_t)c->before[NOW], position);
}

static int begin_periodic(component *c, double *position)
{
    const double *const stored = c->r.periodic, T = c->r.meta[VR_T] >= 0 ? value_of(c, c->r.meta[VR_T]) : 1.0;
    const int32_t n = c->r.meta[FIRST_OUTPUT];
    const char *const remedy = "build it anew with --set, or take the FMU that needs Python";
    if (!c->r.n_periodic)
        return say(c, "network.start = periodic: this FMU, which needs no Python, holds no such start; %s.", remedy);
    if (fabs(c->numbers[T0] - T * rint(c->numbers[T0] / T)) > 1e-9 * T)
        return say(c, "network.start = periodic: this FMU, which needs no Python, starts at multiples of inlet.T; %s.", remedy);
    for (int32_t vr = 0; vr < n; vr++) {
        int32_t open = vr == c->r.meta[VR_INTERPOLATION] || vr == c->r.meta[VR_DRIVE] || vr == c->r.meta[VR_START];
        for (int32_t i = 0; i < c->r.n_inlets; i++) open |= vr == c->r.inlets[PER_INLET * i + VR_INLET];
        if (!open && value_of(c, vr) != stored[vr])
            return say(c, "network.start = periodic: this FMU, which needs no Python, holds that of its start values, and %s is "
                          "another one; %s.", name_of(c, (uint32_t)vr), remedy);
    }
    position[AT_DT] = stored[n];
    memcpy(position + AT_DRIVE + c->r.n_inlets, stored + n + 1, sizeof(double) * (size_t)c->r.n_state);
    return 1;
}

static void begin_at_rest(component *c, double *position)
{
    const int32_t program = (int32_t)c->numbers[NOW];
    const arterial_program *const p = &c->r.recorded[program].program;
    const memory m = memory_for(c, program, bound(c, program, c->numbers + c->now, c->numbers[DT]));
    double *const state = position + AT_DRIVE + c->r.n_inlets, *const H = state + p->n_y + p->n_A;
    const int32_t pair = p->n_Q + p->n_H;
    memset(state, 0, sizeof(double) * (size_t)c->r.n_state);
    memcpy(state, further(c, program, &m, OUT_Y_REST), sizeof(double) * (size_t)p->n_y);
    for (int32_t i = 0; i < p->n_H; i++) {
        H[i] = value_of(c, c->r.meta[VR_P_0]);
        for (int k = 0; k < 2 * STAGES; k++) H[p->n_H + k * pair + p->n_Q + i] = H[i];
    }
    position[AT_DT] = 0.0;
}

int outputs_are_finite(component *c)
{
    for (int32_t vr = c->r.meta[FIRST_OUTPUT]; vr < c->r.meta[FIRST_LATE]; vr++)
        if (!isfinite(value_of(c, vr)))
            return say(c, "%s would be %g: must be finite; check the values of inputs and parameters, and their units.",
                       name_of(c, (uint32_t)vr), value_of(c, vr));
    return 1;
}

/* The outputs of where the component stands, into the values. */
static int show(component *c)
{
    double *const x = c->numbers, *const out = x + c->values + c->r.meta[FIRST_OUTPUT];
    const int32_t program = (int32_t)x[NOW];
    const arterial_program *const p = &c->r.recorded[program].program;
    double *const fixed = bound(c, program, x + c->now, x[LAST_DT]);
    if (!fixed) return say(c, "the equations at rest are singular.");
    const memory m = memory_for(c, program, fixed);
    report(p, &m, x + c->shown + AT_DRIVE + c->r.n_inlets, c->row, acting_at(c, x[TIME], 0.0));
    memcpy(out, c->row, sizeof(double) * (size_t)p->n_report);
    out[p->n_report] = x[V_NOW];
    out[p->n_report + 1] = x[V_VENOUS];
    out[p->n_report + 2] = x[Q_VENOUS];
    x[LATE_DUE] = 1.0;
    return outputs_are_finite(c);
}

static void renew(component *c)
{
    double *const x = c->numbers;
    const size_t bytes = sizeof(double) * (size_t)c->n_position;
    x[BASIS_TIME] = x[TIME];
    x[BASIS_KNOWN] = x[FRESH] != 0.0 ? x[TIME] : x[TIME] - x[LAST_H];
    x[BASIS_H] = x[LAST_H];
    x[BASIS_STEPS] = x[LAST_STEPS];
    x[BASIS_DT] = x[LAST_DT];
    x[FOUND] = 0.0;
    memcpy(x + c->basis_venous, x + c->last_venous, sizeof(double) * (size_t)c->r.n_outlets);
    memcpy(x + c->basis_shown, x + c->shown, bytes);
    memcpy(x + c->basis_known, x + (x[FRESH] != 0.0 ? c->shown : c->known), bytes);
}

static void remember(component *c, const communication_step *s)
{
    double *const x = c->numbers;
    x[LAST_H] = s->h;
    x[LAST_STEPS] = (double)s->steps;
    x[LAST_DT] = s->dt;
    if (s->venous != x + c->last_venous)
        memcpy(x + c->last_venous, s->venous, sizeof(double) * (size_t)c->r.n_outlets);
}

static void venous_values(const component *c, double *found)
{
    for (int32_t i = 0; i < c->r.n_outlets; i++) found[i] = value_of(c, c->r.venous[PER_VENOUS * i + VR_VENOUS]);
}

int initialized(component *c)
{
    double *const x = c->numbers, *const shown = x + c->shown;
    if (c->r.meta[N_ARITHMETIC]) return arithmetic_initialized(c);
    if (!take_over(c)) return 0;
    x[TIME] = x[T0];
    x[OWN] = value_of(c, c->r.meta[VR_DRIVE]) == 2.0;
    x[WAY] = x[OWN] != 0.0 ? LINEAR : value_of(c, c->r.meta[VR_INTERPOLATION]);
    x[HEARD] = 0.0;
    driving(c, x + c->unset);
    for (int32_t i = 0; i < c->r.n_inlets && x[OWN] != 0.0; i++)
        if (c->r.inlets[PER_INLET * i + CURVE] == NO_CURVE)
            return say(c, "inlet.drive = network: network %s gives no curve of %s; add one to the network file and build the FMU "
                          "anew, or take inlet.drive = input and set it.",
                       text(c, c->r.meta[TEXT_NAME]), name_of(c, (uint32_t)c->r.inlets[PER_INLET * i + VR_INLET]));
    if (value_of(c, c->r.meta[VR_START]) == 2.0) {
        if (!begin_periodic(c, shown)) return 0;
    } else {
        begin_at_rest(c, shown);
    }
    shown[HALVED] = shown[V_IN] = 0.0;
    for (int32_t i = 0; i < c->r.n_inlets; i++)
        shown[AT_DRIVE + i] = x[OWN] != 0.0 ? drive_at(c, i, x[T0]) : x[c->unset + i];
    x[FRESH] = 1.0;
    memset(x + c->slope, 0, sizeof(double) * (size_t)c->r.n_inlets);
    venous_values(c, c->pressures);
    const communication_step s = step_of(c, x[DT], c->pressures);
    remember(c, &s);
    renew(c);
    x[V_NOW] = x[V_0] = volume(c, x + c->now, (int32_t)x[NOW], shown);
    x[V_VENOUS] = x[Q_VENOUS] = 0.0;
    x[READY] = 1.0;
    x[OUTDATED] = 0.0;
    return show(c);
}

int component_leave(component *c)
{
    if (!require(c, "exit_initialization_mode", INITIALIZING)) return 0;
    keep(c);
    if (!initialized(c)) return back(c);
    c->numbers[STATE_OF] = STEPPING;
    return 1;
}

/* What the next known, shown and slope are; inputs Q at the inlets. */
static int driven(component *c, const communication_step *s, double *Q)
{
    double *const x = c->numbers, *const shown = x + c->shown, *const known = x + c->known;
    const int32_t n = c->r.n_inlets;
    const size_t bytes = sizeof(double) * (size_t)c->n_position;
    const int end = x[WAY] == HOLD; /* below, what the flow at the start of a communication step is in parts of the input */
    if (c->d && x[WAY] != SMOOTH && !derivative_begins(c, shown, SHOWN, 1, end, x[OWN] == 0.0)) return 0;
    if (x[OWN] != 0.0) return run_along(c, s, shown, x[TIME]);
    if (x[WAY] != SMOOTH) {
        for (int32_t i = 0; i < n; i++) {
            c->answers[i] = x[WAY] == HOLD ? Q[i] : shown[AT_DRIVE + i];
            x[c->slope + i] = (Q[i] - c->answers[i]) / s->h;
        }
        return run_straight(c, s, shown, x[TIME], c->answers, Q);
    }
    memset(x + c->slope, 0, sizeof(double) * (size_t)n);
    if (x[FRESH] != 0.0) {
        memcpy(known, shown, bytes);
        memcpy(known + AT_DRIVE, Q, sizeof(double) * (size_t)n);
    } else {
        for (int32_t i = 0; i < n && s->h <= FURTHEST * x[LAST_H]; i++)
            x[c->slope + i] = (Q[i] - known[AT_DRIVE + i]) / x[LAST_H];
        if (!c->d && same(Q, shown + AT_DRIVE, n)) {
            memcpy(known, shown, bytes);
        } else {
            const communication_step last = {x[LAST_H], x[LAST_DT], (int64_t)x[LAST_STEPS], (int32_t)c->before[NOW],
                                  c->before + c->now, x + c->last_venous};
            if (c->d && !derivative_begins(c, known, KNOWN, 0, 0.0, 1.0)) return 0;
            if (!run_straight(c, &last, known, x[TIME] - x[LAST_H], known + AT_DRIVE, Q)) return 0;
            if (x[RETUNED] != 0.0) under(c, known);
        }
    }
    memcpy(shown, known, bytes);
    for (int32_t i = 0; i < n; i++) c->answers[i] = Q[i] + x[c->slope + i] * s->h;
    const double further = x[FRESH] == 0.0 && s->h <= FURTHEST * x[LAST_H] ? 1.0 + s->h / x[LAST_H] : 1.0;
    x[FRESH] = 0.0;
    if (c->d && !derivative_begins(c, shown, KNOWN_AS_SHOWN, 1, 1.0, further)) return 0;
    if (run_straight(c, s, shown, x[TIME], Q, c->answers)) return 1;
    memcpy(shown, known, bytes); /* of a flow that was only extrapolated: without that */
    memset(x + c->slope, 0, sizeof(double) * (size_t)n);
    if (c->d && !derivative_begins(c, shown, KNOWN_AS_SHOWN, 1, 1.0, 1.0)) return 0;
    return run_straight(c, s, shown, x[TIME], Q, Q);
}

/* The inputs; before the first step of ``smooth`` zeros may mean that nothing has been sent yet. */
static void received(component *c, double *Q, double *P)
{
    const double *const x = c->numbers;
    int any = x[WAY] != SMOOTH || x[FRESH] == 0.0;
    driving(c, Q);
    venous_values(c, P);
    for (int32_t i = 0; i < c->r.n_inlets; i++) any |= Q[i] != 0.0;
    for (int32_t i = 0; i < c->r.n_outlets; i++) any |= P[i] != 0.0;
    if (any) return;
    memcpy(P, x + c->last_venous, sizeof(double) * (size_t)c->r.n_outlets);
    for (int32_t i = 0; i < c->r.n_inlets; i++)
        if (!c->r.inlets[PER_INLET * i + BY_FLOW]) Q[i] = x[c->shown + AT_DRIVE + i];
}

static int retuned(component *c)
{
    double *const x = c->numbers;
    if (!take_over(c)) return 0;
    x[RETUNED] = 1.0;
    x[FOUND] = 0.0;
    under(c, x + c->shown);
    return 1;
}

int begins_here(component *c, double t, double h, double slack)
{
    if (!(isfinite(h) && h > 0.0)) return say(c, "communication step of %g s: must be positive.", h);
    if (!(fabs(t - c->numbers[TIME]) <= slack + 1e-12 * fabs(t)))
        return say(c, "step from t = %.9g s, but the component stands at %.9g s; step on from there or reset.", t,
                   c->numbers[TIME]);
    return 1;
}

static int stepped(component *c, double t, double h)
{
    double *const x = c->numbers, *const Q = c->answers + c->r.n_inlets, halved = x[c->shown + HALVED];
    if (x[HAS_STOP] != 0.0 && t + h > x[STOP] + 1e-6 * fabs(h) + 1e-9 * fabs(t + h))
        return say(c, "step to t = %.9g s: the stop time is %.9g s; end there, or set up a later one.", t + h, x[STOP]);
    if (c->r.meta[N_ARITHMETIC]) return arithmetic_stepped(c, t, h);
    x[RETUNED] = 0.0;
    if (x[CHANGED] != 0.0 && !retuned(c)) return 0;
    if (!begins_here(c, t, h, SLACK * x[DT])) return 0;
    if (h > MOST_STEPS * x[DT])
        return say(c, "communication step of %g s: more than 1000000 internal steps of %g s; take shorter communication steps.",
                   h, x[DT]);
    received(c, Q, c->pressures);
    const communication_step s = step_of(c, h, c->pressures);
    const int heard = x[OWN] != 0.0 && x[HEARD] == 0.0 && !same(Q, x + c->unset, c->r.n_inlets);
    if (!driven(c, &s, Q)) return say(c, "%s", c->failure);
    x[TIME] = t + h;
    if (heard) {
        size_t at = 0;
        x[HEARD] = 1.0;
        for (int32_t i = 0; i < c->r.n_inlets && at < ROOM / 2; i++)
            at += (size_t)snprintf(c->remark + at, ROOM / 2, "%s%.100s", i ? " and " : "",
                                   name_of(c, (uint32_t)c->r.inlets[PER_INLET * i + VR_INLET]));
        snprintf(c->remark + at, ROOM - at, " is ignored: inlet.drive = network; take input to drive the network by it.");
    }
    if (x[c->shown + HALVED] > halved)
        snprintf(c->remark, ROOM, "the step from t = %g s did not converge and was cut into halves; a smaller dt avoids that.", t);
    remember(c, &s);
    x[V_NOW] = volume(c, x + c->now, (int32_t)x[NOW], x + c->shown);
    const double V_venous = x[V_0] + x[c->shown + V_IN] - x[V_NOW];
    x[Q_VENOUS] = (V_venous - x[V_VENOUS]) / h;
    x[V_VENOUS] = V_venous;
    if (!show(c)) return 0;
    if (x[TIME] - x[BASIS_TIME] >= RENEWED || x[RETUNED] != 0.0 || x[LAST_STEPS] != x[BASIS_STEPS] ||
        x[LAST_DT] != x[BASIS_DT])
        renew(c);
    x[CHANGED] = 0.0;
    return 1;
}

int component_again(component *c, double t, double h) { return stepped(c, t, h); }

size_t step_bytes(const component *c) /* not the basis, and what is known only where it is not what is shown */
{
    return sizeof(double) * (size_t)(c->numbers[WAY] == SMOOTH ? c->basis_venous : c->known);
}

int component_step(component *c, double t, double h)
{
    const size_t bytes = step_bytes(c);
    c->remark[0] = 0;
    if (!require(c, "do_step", STEPPING)) return -1;
    memcpy(c->before, c->numbers, bytes);
    c->stepped = stepped(c, t, h);
    if (c->stepped) return 1;
    memcpy(c->numbers, c->before, bytes);
    return 0;
}
