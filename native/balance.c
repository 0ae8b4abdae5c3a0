#include "balance.h"
#include "run.h"

#include <math.h>
#include <string.h>

enum { BLOCK = 32 };

#define LEAST 2.2250738585072014e-308 /* the least normal number */
#define MIXED 2 /* earlier corrections that are mixed into one */
#define SLOW 0.25 /* of the last correction: a smaller one needs no mixing */
#define INDEPENDENT 1e-10 /* of the corrections' squares, added to the normal equations */
#define MINUTE 1e-3 /* of the tolerance: a first correction below it may be round-off, which no further one makes less */

static double *more(const arterial_balance *b, const memory *m, int which)
{
    return placed(m, b->more[which]);
}

static void copy(double *to, const double *from, int64_t n) { memcpy(to, from, sizeof(double) * (size_t)n); }

int arterial_balance_fits(int32_t places, int32_t balance, int32_t period)
{
    return places == BALANCE_PLACES && balance == (int32_t)sizeof(arterial_balance) &&
           period == (int32_t)sizeof(arterial_period);
}

/* --- the steady state, and small waves about it ----------------------------------------------------------------------- */

/* Whether the last step moved no area by more than one per cent: a network that lets nothing out fills for ever. */
static int same_areas(const double *before, const double *after, int32_t n)
{
    for (int32_t i = 0; i < n; i++)
        if (!(fabs(after[i] - before[i]) <= 1e-2 * after[i])) return 0;
    return 1;
}

int arterial_steady(const arterial_balance *b, const double *fixed, double *work, const double *given,
                    const double *lengths, int32_t n, double *y, double *H, double *guess)
{
    const arterial_program *const p = &b->p;
    const memory m = memory_of(p, fixed, work);
    for (int32_t i = 0; i < n; i++) {
        *more(b, &m, IN_TAU) = lengths[i];
        put(p, &m, IN_START, y, p->n_y);
        put(p, &m, IN_H0, H, p->n_H);
        put(p, &m, IN_GIVEN, given, p->n_inlets);
        if (!run(p, &m, START)) return 0;
        put(p, &m, IN_Q, more(b, &m, OUT_GUESS), p->n_Q);
        put(p, &m, IN_H, H, p->n_H);
        if (!solve(p, &m, guess) || !run(p, &m, END)) return 0;
        if (i == n - 1 && !same_areas(y, place(p, &m, OUT_END), p->n_A)) return 0;
        copy(y, place(p, &m, OUT_END), p->n_y);
        copy(H, place(p, &m, IN_H), p->n_H);
    }
    return run(p, &m, CHECK) && *place(p, &m, OUT_MARGIN) > 0.0;
}

int arterial_linearise(const arterial_balance *b, const double *fixed, double *work, const double *y, const double *H,
                       const double *taus, int32_t n, double *held)
{
    memory m = memory_of(&b->p, fixed, work);
    copy(more(b, &m, IN_ABOUT_Y), y, b->p.n_y);
    copy(more(b, &m, IN_ABOUT_H), H, b->p.n_H);
    if (!run(&b->p, &m, ABOUT)) return 0;
    for (int32_t k = 0; k < n; k++) {
        m.held = held + (int64_t)k * b->n_held;
        copy(more(b, &m, IN_TAU_WAVE), taus + 2 * k, 2);
        if (!run(&b->p, &m, LINEARISE)) return 0;
    }
    return 1;
}

/* One answer, (2, n_y + n_H), in its place, to what is driven in its. */
static const double *answer(const arterial_balance *b, const memory *m, int mean)
{
    run(&b->p, m, mean ? RESPOND_MEAN : RESPOND);
    return more(b, m, mean ? OUT_ANSWER_MEAN : OUT_ANSWER);
}

void arterial_answer(const arterial_balance *b, const double *fixed, double *work, double *held, const double *sources,
                     int32_t n, int32_t S, double *answers)
{
    memory m = memory_of(&b->p, fixed, work);
    const int32_t size = 2 * (b->p.n_y + b->p.n_H), n_H = b->p.n_H, n_R = b->n_left - n_H;
    double *const driven = more(b, &m, IN_DRIVEN), *const enters = more(b, &m, IN_ENTERS);
    for (int32_t k = 0; k < n; k++)
        for (int32_t s = 0; s < S; s++) {
            m.held = held + (int64_t)k * b->n_held;
            memset(enters, 0, sizeof(double) * 2 * (size_t)n_H);
            copy(enters, sources + (int64_t)s * b->n_left + n_R, n_H);
            run(&b->p, &m, SCALED);
            memset(driven, 0, sizeof(double) * 2 * (size_t)b->n_left);
            copy(driven, sources + (int64_t)s * b->n_left, n_R);
            copy(driven + n_R, more(b, &m, OUT_SCALED), n_H);
            copy(driven + b->n_left + n_R, more(b, &m, OUT_SCALED) + n_H, n_H);
            copy(answers + ((int64_t)k * S + s) * size, answer(b, &m, k == 0), size);
        }
}

/* --- between harmonics and moments ------------------------------------------------------------------------------------ */

/* sum : (n) of m rows, each so far from the one before, by weights that are as far apart as step says. */
INLINE void weighted(double *restrict sum, const double *restrict row, int64_t stride, const double *restrict weight,
                     int32_t step, int32_t m, int32_t n)
{
    int32_t i, k = 0;
    for (i = 0; i < n; i++) sum[i] = 0.0;
    for (; k + 4 <= m; k += 4, row += 4 * stride, weight += 4 * step) {
        const double *const b = row + stride, *const c = b + stride, *const d = c + stride;
        const double w = weight[0], x = weight[step], y = weight[2 * step], z = weight[3 * step];
        for (i = 0; i < n; i++) sum[i] += (w * row[i] + x * b[i]) + (y * c[i] + z * d[i]);
    }
    for (; k < m; k++, row += stride, weight += step)
        for (i = 0; i < n; i++) sum[i] += weight[0] * row[i];
}

PLAIN_AND_WIDE(weigh, weighted, (double *sum, const double *row, int64_t stride, const double *weight, int32_t step,
                                 int32_t m, int32_t n), (sum, row, stride, weight, step, m, n))
typedef void (*weighing)(double *, const double *, int64_t, const double *, int32_t, int32_t, int32_t);

/* Values v : (4 K, n) at the moments of a period of amplitudes x. The turns of even harmonics repeat after half a
   period, those of odd ones change sign there; a quarter of the period tells the rest. */
static void values(weighing weigh, const arterial_period *period, const double *x, int32_t n, double *v)
{
    const int32_t K = period->K, odd_ones = (K + 1) / 2;
    for (int32_t from = 0; from < n; from += BLOCK) {
        const int32_t w = n - from < BLOCK ? n - from : BLOCK;
        const double *const odd = x + 2 * (int64_t)n + from, *const even = odd + 2 * (int64_t)n;
        for (int32_t j = 0; j <= K; j++) {
            double a[BLOCK], d[BLOCK], odd_a[BLOCK], odd_d[BLOCK];
            const double *const c = period->turn + 2 * (int64_t)j * (K + 1), *const s = c + K + 1;
            weigh(a, even, 4 * (int64_t)n, c + 2, 2, K / 2, w);
            weigh(d, even + n, 4 * (int64_t)n, s + 2, 2, K / 2, w);
            weigh(odd_a, odd, 4 * (int64_t)n, c + 1, 2, odd_ones, w);
            weigh(odd_d, odd + n, 4 * (int64_t)n, s + 1, 2, odd_ones, w);
            double *const first = v + (int64_t)j * n + from, *const mirrored = v + (int64_t)(2 * K - j) * n + from;
            double *const half = first + (int64_t)2 * K * n, *const last = j ? v + (int64_t)(4 * K - j) * n + from : first;
            for (int32_t i = 0; i < w; i++) {
                const double mean = x[from + i];
                last[i] = mean + 2.0 * ((a[i] + d[i]) + (odd_a[i] + odd_d[i]));
                mirrored[i] = mean + 2.0 * ((a[i] + d[i]) - (odd_a[i] + odd_d[i]));
                first[i] = mean + 2.0 * ((a[i] - d[i]) + (odd_a[i] - odd_d[i]));
                half[i] = mean + 2.0 * ((a[i] - d[i]) - (odd_a[i] - odd_d[i]));
            }
        }
    }
}

/* Two rows become their sum and their difference. */
static void fold(double *restrict a, double *restrict b, int32_t n, double sign)
{
    for (int32_t i = 0; i < n; i++) {
        const double x = a[i], y = sign * b[i];
        a[i] = x + y;
        b[i] = x - y;
    }
}

/* Amplitudes x of values v : (4 K, n), which are lost. */
static void amplitudes(weighing weigh, const arterial_period *period, double *v, int32_t n, double *x)
{
    const int32_t K = period->K, half = 2 * K;
    for (int32_t j = 0; j < half; j++) fold(v + (int64_t)j * n, v + (int64_t)(j + half) * n, n, 1.0);
    for (int32_t j = 1; j < K; j++) {
        fold(v + (int64_t)j * n, v + (int64_t)(half - j) * n, n, 1.0);
        fold(v + (int64_t)(half + j) * n, v + (int64_t)(2 * half - j) * n, n, -1.0);
    }
    for (int32_t from = 0; from < n; from += BLOCK) {
        const int32_t w = n - from < BLOCK ? n - from : BLOCK;
        for (int32_t k = 0; k <= K; k++) {
            double a[BLOCK], d[BLOCK];
            const double *const c = period->turn + 2 * (int64_t)k * (K + 1), *const s = c + K + 1;
            const double *const row = v + (k & 1 ? (int64_t)half * n : 0) + from;
            weigh(a, row, n, c, 1, K + 1, w);
            weigh(d, row + (int64_t)(half - 1) * n, -n, s + 1, 1, K, w);
            for (int32_t i = 0; i < w; i++) {
                x[2 * (int64_t)k * n + from + i] = a[i] / (4 * K);
                x[(2 * (int64_t)k + 1) * n + from + i] = -d[i] / (4 * K);
            }
        }
    }
}

/* --- the balance ------------------------------------------------------------------------------------------------------ */

typedef struct {
    double *waves, *v, *out, *left, *filled, *corrected, *past, *mixed; /* see arterial_scratch */
} scratch_parts;

static int32_t widest(const arterial_balance *b)
{
    int32_t n = b->n_left > b->n_observed ? b->n_left : b->n_observed;
    n = n > b->n_unfilled ? n : b->n_unfilled;
    return n > b->n_unremembered ? n : b->n_unremembered;
}

static scratch_parts parted(const arterial_balance *b, const arterial_period *period, double *scratch, int64_t *size)
{
    const int64_t moments = 4 * period->K, harmonics = 2 * (period->K + 1), X = harmonics * (b->p.n_y + b->p.n_H);
    scratch_parts s;
    s.waves = scratch;
    s.v = s.waves + harmonics * b->n_now;
    s.out = s.v + moments * b->n_now;
    s.left = s.out + moments * widest(b);
    s.filled = s.left + harmonics * widest(b);
    s.corrected = s.filled + X;
    s.past = s.corrected + X;
    s.mixed = s.past + harmonics * b->n_past; /* of each earlier correction the waves before and after it */
    if (size) *size = s.mixed + 2 * MIXED * X - scratch;
    return s;
}

int64_t arterial_scratch(const arterial_balance *b, const arterial_period *period)
{
    static const double nothing = 0.0;
    int64_t size;
    parted(b, period, (double *)&nothing, &size);
    return size;
}

/* What phases are given of a moment, where each part begins: A, Q, P_C and the past at the start of the stage that ends
   there; drive, H, Q, A, P_C, dA/dt, stress and history at its end. A phase takes a range of them. */
typedef struct {
    int32_t start, past, drive, H, Q, A, P_C, A_t, memories, all;
} moment_parts;

static moment_parts parts_of(const arterial_balance *b)
{
    moment_parts at = {0};
    at.past = b->at_memories;
    at.drive = at.past + b->n_past;
    at.H = at.drive + b->p.n_inlets;
    at.Q = at.H + b->p.n_H;
    at.A = at.Q + b->p.n_Q;
    at.P_C = at.A + b->p.n_A;
    at.A_t = at.Q + b->at_memories;
    at.memories = at.A_t + b->p.n_A;
    at.all = at.memories + b->n_memories;
    return at;
}

static void range_of(const moment_parts *at, int phase, int32_t *from, int32_t *to)
{
    *from = phase == REMEMBER ? at->Q : phase == OBSERVE ? at->H : at->start;
    *to = phase == MOMENT ? at->A : phase == OBSERVE ? at->all : at->memories;
}

/* The n numbers s->out that a phase leaves at every moment of waves X : (K + 1, 2, n_y + n_H) under drive. */
static void moments(const arterial_balance *b, const arterial_period *period, const memory *m, const double *X,
                    const double *drive, int phase, int out, int32_t n, const scratch_parts *s)
{
    const int32_t n_y = b->p.n_y, n_H = b->p.n_H, n_in = b->p.n_inlets, n_fluid = b->at_memories, n_past = b->n_past;
    const moment_parts at = parts_of(b);
    int32_t from, to;
    range_of(&at, phase, &from, &to);
    const int32_t N = to - from;
    for (int32_t k = 0; k <= period->K; k++)
        for (int32_t part = 0; part < 2; part++) {
            const int64_t row = 2 * (int64_t)k + part, twin = row + 1 - 2 * part;
            const double *const x = X + row * (n_y + n_H), *const other = X + twin * (n_y + n_H);
            const double *const p = s->past + row * n_past, *const other_p = s->past + twin * n_past;
            const double w = part ? period->omega[k] : -period->omega[k], back = -period->stage * w;
            double *const of = s->waves + row * N - from;
            if (from <= at.start) {
                for (int32_t i = 0; i < n_fluid; i++) of[at.start + i] = x[i] + back * other[i];
                for (int32_t i = 0; i < n_past; i++) of[at.past + i] = p[i] + back * other_p[i];
                for (int32_t i = 0; i < n_in; i++) of[at.drive + i] = drive[row * n_in + i];
            }
            if (from <= at.H) copy(of + at.H, x + n_y, n_H);
            copy(of + at.Q, x + b->p.at_Q, b->p.n_Q);
            if (to > at.A) copy(of + at.A, x, b->p.n_A), copy(of + at.P_C, x + b->at_stored, at.A_t - at.P_C);
            if (to > at.A_t)
                for (int32_t i = 0; i < b->p.n_A; i++) of[at.A_t + i] = w * other[i];
            if (to > at.memories) copy(of + at.memories, x + n_fluid, b->n_memories);
        }
    values(b->p.wide ? weigh_wide : weigh_plain, period, s->waves, N, s->v);
    for (int32_t j = 0; j < 4 * period->K; j++) {
        copy(more(b, m, IN_NOW) + from, s->v + (int64_t)j * N, N);
        run(&b->p, m, phase);
        copy(s->out + (int64_t)j * n, more(b, m, out), n);
    }
}

/* The waves with areas that take what flows in and does not leak. */
static void fill(const arterial_balance *b, const arterial_period *period, memory *m, double *held, double *X,
                 const double *drive, const scratch_parts *s)
{
    const int32_t n = b->n_unfilled, size = b->p.n_y + b->p.n_H;
    moments(b, period, m, X, drive, FILL, OUT_UNFILLED, n, s);
    amplitudes(b->p.wide ? weigh_wide : weigh_plain, period, s->out, n, s->left);
    for (int32_t k = 0; k <= period->K; k++) {
        m->held = held + (int64_t)k * b->n_held;
        copy(more(b, m, IN_FLOW_IN), s->left + 2 * (int64_t)k * n, 2 * n);
        run(&b->p, m, FILLED);
        for (int32_t part = 0; part < 2; part++)
            for (int32_t i = 0; i < n; i++) X[(2 * (int64_t)k + part) * size + i] += more(b, m, OUT_CHANGE)[part * n + i];
    }
}

/* The waves with what walls and fluid remember. */
static void remember(const arterial_balance *b, const arterial_period *period, memory *m, double *held, double *X,
                     const scratch_parts *s)
{
    const int32_t n = b->n_unremembered, size = b->p.n_y + b->p.n_H;
    moments(b, period, m, X, 0, REMEMBER, OUT_UNREMEMBERED, n, s);
    amplitudes(b->p.wide ? weigh_wide : weigh_plain, period, s->out, n, s->left);
    for (int32_t k = 0; k <= period->K; k++) {
        m->held = held + (int64_t)k * b->n_held;
        copy(more(b, m, IN_FORGOTTEN), s->left + 2 * (int64_t)k * n, 2 * n);
        run(&b->p, m, RECALL);
        for (int32_t part = 0; part < 2; part++)
            copy(X + (2 * (int64_t)k + part) * size + b->at_memories, more(b, m, OUT_MEMORIES) + part * b->n_memories,
                 b->n_memories);
        copy(s->past + 2 * (int64_t)k * b->n_past, more(b, m, OUT_PAST), 2 * b->n_past);
    }
}

/* Adds to all amplitudes x of n numbers, from the first one of each on, those of dx. */
static void add(double *x, const double *dx, int32_t n)
{
    for (int32_t i = 0; i < n; i++) x[i] += dx[i];
}

/* s->left : what the equations of these waves leave. */
static void leave(const arterial_balance *b, const arterial_period *period, memory *m, double *held, const double *X,
                  const double *drive, const double *forced, const scratch_parts *s)
{
    const int32_t n = b->n_left;
    if (b->n_unfilled) {
        copy(s->filled, X, 2 * (period->K + 1) * (b->p.n_y + b->p.n_H));
        fill(b, period, m, held, s->filled, drive, s);
        X = s->filled;
    }
    moments(b, period, m, X, drive, MOMENT, OUT_LEFT, n, s);
    amplitudes(b->p.wide ? weigh_wide : weigh_plain, period, s->out, n, s->left);
    if (forced) add(s->left, forced, 2 * (period->K + 1) * n);
}

/* The waves with the correction that s->left asks for, and how large it is, in parts of the flows that pulsate. */
static double correct(const arterial_balance *b, const arterial_period *period, memory *m, double *held,
                      const double *X, double *corrected, const scratch_parts *s)
{
    const int32_t size = b->p.n_y + b->p.n_H, n = b->n_left;
    const double *const from = b->n_unfilled ? s->filled : X;
    double moved = 0.0, pulsating = 0.0;
    for (int32_t k = 0; k <= period->K; k++) {
        m->held = held + (int64_t)k * b->n_held;
        copy(more(b, m, IN_DRIVEN), s->left + 2 * (int64_t)k * n, 2 * n);
        const double *const change = answer(b, m, k == 0);
        const double *const x = from + 2 * (int64_t)k * size;
        double *const to = corrected + 2 * (int64_t)k * size;
        for (int32_t i = 0; i < 2 * size; i++) to[i] = x[i] + change[i];
        for (int32_t part = 0; part < 2 && k; part++)
            for (int32_t i = part * size + b->p.at_Q; i < part * size + b->p.at_Q + b->p.n_Q; i++) {
                moved += change[i] * change[i];
                pulsating += to[i] * to[i];
            }
    }
    pulsating = sqrt(pulsating);
    return sqrt(moved) / (pulsating < LEAST ? LEAST : pulsating);
}

/* The product of two corrections of the flows, each the difference of waves. */
static double product(const arterial_balance *b, const arterial_period *period, const double *to, const double *from,
                      const double *other_to, const double *other_from)
{
    const int32_t size = b->p.n_y + b->p.n_H;
    double sum = 0.0;
    for (int32_t row = 0; row < 2 * (period->K + 1); row++)
        for (int32_t i = row * size + b->p.at_Q; i < row * size + b->p.at_Q + b->p.n_Q; i++)
            sum += (to[i] - from[i]) * (other_to[i] - other_from[i]);
    return sum;
}

/* Mixes n earlier corrections into s->corrected, so that the mixed correction of the flows is least:
   solver/periodic/mixing.py. */
static void mix(const arterial_balance *b, const arterial_period *period, int32_t n, const double *X,
                const scratch_parts *s)
{
    const int32_t all = 2 * (period->K + 1) * (b->p.n_y + b->p.n_H);
    const double *x[MIXED], *g[MIXED];
    double gram[MIXED][MIXED] = {{0.0}}, right[MIXED] = {0.0}, w[MIXED] = {0.0};
    double own = product(b, period, s->corrected, X, s->corrected, X), with[MIXED];
    for (int32_t j = 0; j < n; j++) {
        x[j] = s->mixed + 2 * (int64_t)j * all;
        g[j] = x[j] + all;
        with[j] = product(b, period, s->corrected, X, g[j], x[j]);
        right[j] = own - with[j];
    }
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n; j++)
            gram[i][j] = own - with[i] - with[j] + product(b, period, g[i], x[i], g[j], x[j]);
    const double more = INDEPENDENT * (gram[0][0] + gram[1][1]) + LEAST;
    for (int32_t j = 0; j < n; j++) gram[j][j] += more;
    if (n == 1)
        w[0] = right[0] / gram[0][0];
    else {
        const double det = gram[0][0] * gram[1][1] - gram[0][1] * gram[1][0];
        w[0] = (right[0] * gram[1][1] - right[1] * gram[0][1]) / det;
        w[1] = (right[1] * gram[0][0] - right[0] * gram[1][0]) / det;
    }
    for (int32_t i = 0; i < all; i++) {
        double less = 0.0;
        for (int32_t j = 0; j < n; j++) less += w[j] * (s->corrected[i] - g[j][i]);
        s->filled[i] = s->corrected[i] - less;
    }
}

int32_t arterial_balanced(const arterial_balance *b, const arterial_period *period, const double *fixed, double *work,
                          double *held, const double *drive, const double *forced, const double *let_out,
                          double tolerance, double of_first, int32_t most, double *X, double *scratch,
                          double *last, double *left)
{
    memory m = memory_of(&b->p, fixed, work);
    const scratch_parts s = parted(b, period, scratch, 0);
    const int32_t size = b->p.n_y + b->p.n_H, all = 2 * (period->K + 1) * size;
    int32_t made = 0;
    double enough = tolerance;
    *last = INFINITY;
    for (int32_t k = 0; let_out && k <= period->K; k++) {
        m.held = held + (int64_t)k * b->n_held;
        copy(more(b, &m, IN_LET_OUT), let_out + 2 * (int64_t)k * b->n_stored, 2 * b->n_stored);
        run(&b->p, &m, STORED);
        for (int32_t part = 0; part < 2; part++)
            add(X + (2 * (int64_t)k + part) * size + b->at_stored, more(b, &m, OUT_CHARGED) + part * b->n_stored,
                b->n_stored);
    }
    if (b->n_unremembered) remember(b, period, &m, held, X, &s);
    while (made < most) {
        leave(b, period, &m, held, X, drive, forced, &s);
        const double now = correct(b, period, &m, held, X, s.corrected, &s);
        if (!made++ && of_first > 0.0) enough = of_first * (now > MINUTE * tolerance ? now : MINUTE * tolerance);
        if (!(now < *last)) { /* what was there before it grew stands */
            if (made > 1) copy(X, s.mixed + 2 * (int64_t)(made % MIXED) * all, all);
            break;
        }
        const int32_t earlier = made - 1 < MIXED ? made - 1 : MIXED, slow = earlier && now > SLOW * *last;
        if (slow) mix(b, period, earlier, X, &s);
        double *const kept = s.mixed + 2 * (int64_t)((made - 1) % MIXED) * all;
        copy(kept, X, all);
        copy(kept + all, s.corrected, all);
        copy(X, slow ? s.filled : s.corrected, all);
        if (b->n_unremembered) remember(b, period, &m, held, X, &s);
        *last = now;
        if (now <= enough) {
            if (left) {
                leave(b, period, &m, held, X, drive, forced, &s);
                copy(left, s.left, 2 * (period->K + 1) * b->n_left);
            }
            return made;
        }
    }
    *last = INFINITY;
    return made;
}

int arterial_observed(const arterial_balance *b, const arterial_period *period, const double *fixed, double *work,
                      const double *X, double *scratch, double *found)
{
    const memory m = memory_of(&b->p, fixed, work);
    const scratch_parts s = parted(b, period, scratch, 0);
    const int32_t n = b->n_observed, columns = n - 1;
    moments(b, period, &m, X, 0, OBSERVE, OUT_OBSERVED, n, &s);
    for (int32_t j = 0; j < 4 * period->K; j++)
        if (!(s.out[(int64_t)j * n + columns] > 0.0)) return 0;
    amplitudes(b->p.wide ? weigh_wide : weigh_plain, period, s.out, n, s.left);
    for (int32_t row = 0; row < 2 * (period->K + 1); row++)
        copy(found + (int64_t)row * columns, s.left + (int64_t)row * n, columns);
    return 1;
}
