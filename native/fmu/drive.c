/* What the network itself gives at its inlets, and what its tables of sources give: a half-sine, a cubic through a table,
   or a Fourier series. */
#include "component.h"

#include <math.h>

static double cubic(const double *t, int32_t n, double phase) /* t, values, second derivatives : (n,) each */
{
    const double *const y = t + n, *const M = y + n, x = phase * t[n - 1];
    int32_t low = 0, high = n - 1;
    while (high - low > 1) {
        const int32_t middle = (low + high) / 2;
        if (t[middle] <= x) low = middle; else high = middle;
    }
    const double h = t[low + 1] - t[low], left = (t[low + 1] - x) / h, right = (x - t[low]) / h;
    const double bend = (left * left * left - left) * M[low] + (right * right * right - right) * M[low + 1];
    return left * y[low] + right * y[low + 1] + bend * h * h / 6.0;
}

static double fourier(const double *a, int32_t n, double phase) /* a_0 … a_K, -b_0 … -b_K */
{
    const double turn = 2.0 * 3.141592653589793 * phase, c = cos(turn), s = sin(turn);
    const int32_t K = n / 2;
    double re = 0.0, im = 0.0;
    for (int32_t k = K - 1; k >= 0; k--) {
        const double old = re;
        re = re * c - im * s + a[k];
        im = old * s + im * c + a[K + k];
    }
    return re;
}

/* Where in its period a time lies, from 0 to 1. */
static double phase_of(double t, double T)
{
    const double phase = fmod(t / T, 1.0);
    return phase < 0.0 ? phase + 1.0 : phase;
}

const double *acting_at(component *c, double t, double dt)
{
    for (int k = 0; k <= STAGES; k++) {
        const double at = k ? SDIRK3[k - 1][0] + SDIRK3[k - 1][1] + SDIRK3[k - 1][2] : 0.0;
        for (int32_t i = 0; i < c->r.n_sources; i++) {
            const int32_t *const row = c->r.sources + PER_SOURCE * i, n = row[SOURCE_SIZE];
            const double *const curve = c->r.curves + row[SOURCE_AT], phase = phase_of(t + at * dt, c->r.source_periods[i]);
            c->acting[k * c->r.n_sources + i] = row[SOURCE_CURVE] == CUBIC ? cubic(curve, n, phase) : fourier(curve, n, phase);
        }
    }
    return c->acting;
}

double drive_at(component *c, int32_t i, double t)
{
    const int32_t *const row = c->r.inlets + PER_INLET * i, vr = row[VR_MEAN];
    const double *const own = c->r.inlet_numbers + PER_INLET_NUMBERS * i, *const curve = c->r.curves + row[CURVE_AT];
    const double T = c->r.meta[VR_T] >= 0 ? value_of(c, c->r.meta[VR_T]) : own[OWN_T];
    const double mean = vr >= 0 ? value_of(c, vr) : own[OWN_MEAN];
    const double phase = phase_of(t, T);
    if (row[CURVE] == HALF_SINE || (row[BY_FLOW] && own[OWN_MEAN] == 0.0)) {
        const double most = mean == own[OWN_MEAN] && row[CURVE] == HALF_SINE ? own[OWN_MAX] : 3.141592653589793 * mean;
        return most * fmax(0.0, sin(2.0 * 3.141592653589793 * phase));
    }
    const int32_t n = row[CURVE_SIZE];
    const double x = row[CURVE] == CUBIC ? cubic(curve, n, phase) : fourier(curve, n, phase);
    if (mean == own[OWN_MEAN]) return x;
    return row[BY_FLOW] ? x * (mean / own[OWN_MEAN]) : x + (mean - own[OWN_MEAN]);
}
