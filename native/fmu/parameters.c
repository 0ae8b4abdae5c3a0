/* The parameters: whether they fit each other and one of the programs, and what to say where they do not. */
#include "component.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const double LARGEST_RATIO = 100.0;
static const char REMEDY[] = "build it anew with --set, or take the FMU that needs Python";

static int ratios_fit(component *c)
{
    for (int32_t i = 0; i < c->r.n_segments; i++) {
        const int32_t *const s = c->r.segments + PER_SEGMENT * i;
        const double phi0 = value_of(c, s[VR_PHI0]), phiNL = value_of(c, s[VR_PHINL]);
        const char *const name = text(c, s[SEGMENT_NAME]);
        if (fabs(phiNL) > LARGEST_RATIO * phi0)
            return say(c,
                       "%.100s.phiNL = %g Pa.s^2 is too large for %.100s.phi0 = %g Pa.s: phiNL/phi0 must lie in [-100, 100] "
                       "s; set %.100s.phiNL to 0 or raise %.100s.phi0.",
                       name, phiNL, name, phi0, name, name);
    }
    return 1;
}

static int can_rest(component *c, int32_t program, double *fixed)
{
    const memory m = memory_for(c, program, fixed);
    const double *const A = further(c, program, &m, OUT_A_REST), *const lost = further(c, program, &m, OUT_LOST_AT_REST);
    const int32_t *const law = variable(c, (uint32_t)c->r.meta[VR_ELASTIC]);
    const char *name, *which = text(c, law[ITEMS]);
    for (int k = 1; k < (int)value_of(c, c->r.meta[VR_ELASTIC]); k++) which += strlen(which) + 1;
    for (int32_t e = 0; e < c->r.n_elements; e++)
        if (!(A[e] > 0.0)) {
            name = text(c, c->r.segments[PER_SEGMENT * c->r.elements[e] + SEGMENT_NAME]);
            return say(c,
                       "network.P_0: the wall of segment %.100s cannot carry the start pressure under the %s law; bring "
                       "network.P_0 nearer to the pressure at which R = R0, or raise %.100s.E or %.100s.h.",
                       name, which, name, name);
        }
    for (int32_t i = 0; i < c->r.n_outlets; i++)
        if (lost[i] != 0.0) {
            name = text(c, c->r.segments[PER_SEGMENT * c->r.venous[PER_VENOUS * i + OUTLET_SEGMENT] + SEGMENT_NAME]);
            return say(c,
                       "%.100s.outlet.P_venous: the wall at the outlet cannot carry P_0 - P_venous under the %s law; bring "
                       "%.100s.outlet.P_venous nearer to network.P_0.",
                       name, which, name);
        }
    return 1;
}

/* The first program that has what the parameters need, in ``fixed`` its numbers; -1 where none has, -2 none of the laws. */
static int32_t program_for(component *c, double **fixed)
{
    double *const x = c->numbers;
    int32_t found = -2;
    for (int32_t i = 0; i < c->r.n_parameters; i++) x[c->now + i] = value_of(c, c->r.parameters[i]);
    for (int32_t i = 0; i < c->r.meta[N_PROGRAMS]; i++) {
        const int32_t *const meta = c->r.recorded[i].meta;
        if (meta[ELASTIC] != (int32_t)value_of(c, c->r.meta[VR_ELASTIC])) continue;
        if (meta[VISCOUS] && meta[VISCOUS] != (int32_t)value_of(c, c->r.meta[VR_VISCOUS])) continue;
        found = -1;
        *fixed = bound(c, i, x + c->now, value_of(c, c->r.meta[VR_DT]));
        if (*fixed) return i;
    }
    return found;
}

static int fits_with(component *c, int32_t vr, double value)
{
    double *fixed;
    c->numbers[c->values + vr] = value;
    return program_for(c, &fixed) >= 0;
}

/* How far a variable may go from its start value towards an end of its range. */
static double as_far_as(component *c, int32_t vr, double end)
{
    double good = c->r.ranges[PER_RANGE * vr + START_VALUE], bad = end;
    if (fits_with(c, vr, end)) return end;
    for (int k = 0; k < 60 && fabs(bad - good) > 1e-4 * fabs(good); k++) {
        const double middle = 0.5 * (good + bad);
        if (fits_with(c, vr, middle)) good = middle;
        else bad = middle;
    }
    return good;
}

/* The variable i of those that programs are made for: parameters, and the length of elements. */
static int32_t made_for(const component *c, int32_t i)
{
    return i < c->r.n_parameters ? c->r.parameters[i] : c->r.meta[VR_LENGTH];
}

/* Which parameter no program has: the first one without whose change they would fit; else the first one that lets them
   fit after all before it are taken back, too. It changes values, which the caller puts back. */
static int tell_which(component *c)
{
    for (int together = 0; together < 2; together++)
        for (int32_t i = 0; i <= c->r.n_parameters; i++) {
            const int32_t vr = made_for(c, i);
            const double *const range = c->r.ranges + PER_RANGE * vr, value = value_of(c, vr);
            if (value == range[START_VALUE]) continue;
            if (!fits_with(c, vr, range[START_VALUE])) {
                if (!together) c->numbers[c->values + vr] = value;
                continue;
            }
            const char *const name = name_of(c, (uint32_t)vr), *const unit = text(c, variable(c, (uint32_t)vr)[UNIT]);
            const double low = as_far_as(c, vr, range[LOW]), high = as_far_as(c, vr, range[HIGH]);
            const char *const but = low < value && value < high ? ", except at this value" : ""; /* it switches an effect off */
            return say(c, "%s = %g %s: needs another mesh, or another program, than this FMU, which needs no Python, was built "
                          "with: %s may lie in [%.4g, %.4g] %s here%s; %s.", name, value, unit, name, low, high, unit, but, REMEDY);
        }
    return say(c, "these parameters need another mesh than this FMU, which needs no Python, was built with; %s.", REMEDY);
}

int take_over(component *c)
{
    double *fixed;
    if (!ratios_fit(c)) return 0;
    const int32_t program = program_for(c, &fixed);
    if (program == -2)
        return say(c, "network.elastic_law or network.viscous_law: this FMU, which needs no Python, was built for another one; "
                      "%s.", REMEDY);
    if (program < 0) return tell_which(c);
    c->numbers[NOW] = program;
    c->numbers[DT] = value_of(c, c->r.meta[VR_DT]);
    return can_rest(c, program, fixed);
}
