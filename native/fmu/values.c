/* The values of variables, read and set, as fmu_src/slaves/base.py has it. */
#include "component.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static int of_kind(component *c, const uint32_t *vr, size_t n, int kind)
{
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= (uint32_t)c->r.meta[N_VARIABLES])
            return say(c, "value reference %ld: there is no such variable.", (long)(int32_t)vr[i]);
        const int32_t has = variable(c, vr[i])[KIND];
        if (has != kind)
            return say(c, "%s is %s; read and set it as such.", name_of(c, vr[i]),
                       has == REAL ? "a Real variable" : "an Enumeration (Integer)");
    }
    return 1;
}

int component_read(component *c, const uint32_t *vr, size_t n, int kind, double *values)
{
    double *const x = c->numbers;
    uint32_t last = 0;
    if (!of_kind(c, vr, n, kind)) return 0;
    for (size_t i = 0; i < n; i++) last = vr[i] > last ? vr[i] : last;
    if (x[STATE_OF] == INITIALIZING && x[OUTDATED] != 0.0 && last >= (uint32_t)c->r.meta[FIRST_OUTPUT]) {
        keep(c);
        if (!initialized(c)) return back(c);
    }
    if (x[LATE_DUE] != 0.0 && last >= (uint32_t)c->r.meta[FIRST_LATE]) {
        if (!ports(c, x + c->values + c->r.meta[FIRST_LATE])) return 0;
        x[LATE_DUE] = 0.0;
    }
    for (size_t i = 0; i < n; i++) values[i] = x[c->values + vr[i]];
    return 1;
}

static int allowed(component *c, uint32_t vr, double value)
{
    const int32_t *const v = variable(c, vr);
    const double low = c->r.ranges[PER_RANGE * vr + LOW], high = c->r.ranges[PER_RANGE * vr + HIGH];
    const char *const name = name_of(c, vr), *const unit = text(c, v[UNIT]), *item = text(c, v[ITEMS]);
    const int phase = (int)c->numbers[STATE_OF];
    if (v[CAUSALITY] == OUTPUT) return say(c, "%s is an output and cannot be set.", name);
    if (v[VARIABILITY] == FIXED && phase >= STEPPING)
        return say(c, "%s is fixed: set it before initialization ends, or reset the component.", name);
    if (v[KIND] == ENUMERATION) {
        if (value >= 1.0 && value <= v[CHOICES]) return 1;
        int at = snprintf(c->said, ROOM, "%s = %.0f: must be ", name, value);
        for (int32_t i = 1; i <= v[CHOICES] && at < ROOM; i++, item += strlen(item) + 1)
            at += snprintf(c->said + at, (size_t)(ROOM - at), "%s%d (%s)", i > 1 ? " or " : "", (int)i, item);
        if (at < ROOM) snprintf(c->said + at, (size_t)(ROOM - at), ".");
        return 0;
    }
    if (!isfinite(value) || value > high || (v[FLAGS] & OPEN_LOW ? value <= low : value < low))
        return say(c, "%s = %g %s is not allowed: %s must lie in %s%g, %g] %s; check the value and its unit.", name, value, unit,
                   text(c, v[DESCRIPTION]), v[FLAGS] & OPEN_LOW ? "(" : "[", low, high, unit);
    if (v[FLAGS] & WHOLE && value != floor(value))
        return say(c, "%s = %g is not allowed: %s must be a whole number.", name, value, text(c, v[DESCRIPTION]));
    return 1;
}

int component_write(component *c, const uint32_t *vr, size_t n, int kind, const double *values)
{
    double *const x = c->numbers;
    if (!of_kind(c, vr, n, kind)) return 0;
    for (size_t i = 0; i < n; i++)
        if (!allowed(c, vr[i], values[i])) return 0;
    for (size_t i = 0; i < n; i++) {
        if (values[i] != x[c->values + vr[i]]) {
            x[OUTDATED] = 1.0;
            if (x[STATE_OF] == STEPPING && variable(c, vr[i])[CAUSALITY] != INPUT) x[CHANGED] = 1.0;
        }
        x[c->values + vr[i]] = values[i];
    }
    return 1;
}
