/* The operations of array programs. */
#include "engine.h"
#include "run.h"

#include <math.h>
#include <string.h>

#define OPERATIONS(X)                                                                                                  \
    X(copy) X(negative) X(sqrt) X(exp) X(expm1) X(log) X(log1p) X(absolute) X(sign) X(square) X(reciprocal) X(sin)     \
    X(cos) X(sinh) X(cosh) X(tanh) X(logical_not) X(isfinite) X(add) X(subtract) X(multiply) X(divide) X(power)        \
    X(maximum) X(minimum)                                                                                              \
    X(greater) X(greater_equal) X(less) X(less_equal) X(equal) X(not_equal) X(logical_and) X(logical_or) X(where)      \
    X(multiply_add) X(multiply_multiply)                                                                               \
    X(gather) X(scatter) X(sums) X(product) X(inverse) X(sum) X(largest) X(least) X(require) X(skip)
#define CODE(name) OP_##name,
#define NAME(name) #name " "
enum { GROUP, OPERATIONS(CODE) LAST };

#ifndef ARTERIAL_SOURCES /* a digest, which native/build.py gives */
#define ARTERIAL_SOURCES ""
#endif

int arterial_fits(const char *operations, int32_t places, int32_t program, const char *sources)
{
    return strcmp(operations, OPERATIONS(NAME)) == 0 && places == PLACES &&
           program == (int32_t)sizeof(arterial_program) && (!*sources || strcmp(sources, ARTERIAL_SOURCES) == 0);
}

#if defined(__GNUC__) && defined(__x86_64__)
#include <cpuid.h>

int32_t arterial_wide(void)
{
    unsigned a, b, c, d, kept, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c >> 27 & 3) != 3) return 0;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0)); /* whether the system keeps the registers */
    return (kept & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b >> 5 & 1);
}
#else
int32_t arterial_wide(void) { return 0; }
#endif

/* --- elementwise --------------------------------------------------------------------------------------------------- */

#define UNARY(name, expression)                                                                                        \
    case OP_##name:                                                                                                    \
        for (i = 0; i < n; i++) { const double x = a[i * sa]; o[i] = (expression); }                                   \
        break;
#define FAST_UNARY(name, expression)                                                                                   \
    case OP_##name:                                                                                                    \
        if (sa) for (i = 0; i < n; i++) { const double x = a[i]; o[i] = (expression); }                                \
        else { const double x = a[0], y = (expression); for (i = 0; i < n; i++) o[i] = y; }                            \
        break;
#define BINARY(name, expression)                                                                                       \
    case OP_##name:                                                                                                    \
        if (sa && sb) for (i = 0; i < n; i++) { const double x = a[i], y = b[i]; o[i] = (expression); }                \
        else if (sa) { const double y = b[0]; for (i = 0; i < n; i++) { const double x = a[i]; o[i] = (expression); } } \
        else if (sb) { const double x = a[0]; for (i = 0; i < n; i++) { const double y = b[i]; o[i] = (expression); } } \
        else { const double x = a[0], y = b[0], z = (expression); for (i = 0; i < n; i++) o[i] = z; }                  \
        break;

/* Most operations of a step are these. Returns 0 for others. */
INLINE int simple(int32_t op, int32_t n, double *restrict o, const double *restrict a, int sa,
                  const double *restrict b, int sb, const double *restrict c)
{
    int32_t i;
    switch (op) {
        FAST_UNARY(copy, x)
        FAST_UNARY(absolute, fabs(x))
        BINARY(add, x + y)
        BINARY(subtract, x - y)
        BINARY(multiply, x * y)
    case OP_multiply_add: /* of vectors, as the next one */
        for (i = 0; i < n; i++) o[i] = a[i] * b[i] + c[i];
        break;
    case OP_multiply_multiply:
        for (i = 0; i < n; i++) o[i] = a[i] * b[i] * c[i];
        break;
    default: return 0;
    }
    return 1;
}

#define SLOW_BINARY(name, expression)                                                                                  \
    case OP_##name:                                                                                                    \
        for (i = 0; i < n; i++) { const double x = a[i * sa], y = b[i * sb]; o[i] = (expression); }                    \
        break;

static void elementwise(int32_t op, int32_t n, double *restrict o, const double *restrict a, int sa,
                        const double *restrict b, int sb, const double *restrict c, int sc)
{
    int32_t i;
    switch (op) {
        FAST_UNARY(negative, -x)
        FAST_UNARY(sqrt, sqrt(x))
        FAST_UNARY(square, x * x)
        FAST_UNARY(reciprocal, 1.0 / x)
        UNARY(exp, exp(x))
        UNARY(expm1, expm1(x))
        UNARY(log, log(x))
        UNARY(log1p, log1p(x))
        UNARY(sin, sin(x))
        UNARY(cos, cos(x))
        UNARY(sinh, sinh(x))
        UNARY(cosh, cosh(x))
        UNARY(tanh, tanh(x))
        UNARY(sign, x != x ? x : (double)((x > 0.0) - (x < 0.0)))
        UNARY(logical_not, x == 0.0)
        UNARY(isfinite, x - x == 0.0)
        SLOW_BINARY(divide, x / y)
        SLOW_BINARY(power, pow(x, y))
        SLOW_BINARY(maximum, x >= y || x != x ? x : y)
        SLOW_BINARY(minimum, x <= y || x != x ? x : y)
        SLOW_BINARY(greater, x > y)
        SLOW_BINARY(greater_equal, x >= y)
        SLOW_BINARY(less, x < y)
        SLOW_BINARY(less_equal, x <= y)
        SLOW_BINARY(equal, x == y)
        SLOW_BINARY(not_equal, x != y)
        SLOW_BINARY(logical_and, x != 0.0 && y != 0.0)
        SLOW_BINARY(logical_or, x != 0.0 || y != 0.0)
    case OP_where:
        for (i = 0; i < n; i++) o[i] = a[i * sa] != 0.0 ? b[i * sb] : c[i * sc];
        break;
    default: break;
    }
}

/* --- products and inverses ------------------------------------------------------------------------------------------ */

/* m rows of k numbers, each times a matrix : (k, n), which is by so many numbers further for the next row */
#define ROWS(K, N, FURTHER)                                                                                            \
    for (i = 0; i < m; i++, a += K, b += FURTHER, o += N) {                                                            \
        double s[N];                                                                                                   \
        for (j = 0; j < N; j++) s[j] = a[0] * b[j];                                                                    \
        for (l = 1; l < K; l++)                                                                                        \
            for (j = 0; j < N; j++) s[j] += a[l] * b[l * N + j];                                                       \
        for (j = 0; j < N; j++) o[j] = s[j];                                                                           \
    }

static double dot(const double *restrict a, const double *restrict b, int32_t n)
{
    double s[4] = {0.0, 0.0, 0.0, 0.0};
    int32_t i = 0;
    for (; i + 4 <= n; i += 4) {
        s[0] += a[i] * b[i];
        s[1] += a[i + 1] * b[i + 1];
        s[2] += a[i + 2] * b[i + 2];
        s[3] += a[i + 3] * b[i + 3];
    }
    for (; i < n; i++) s[0] += a[i] * b[i];
    return (s[0] + s[1]) + (s[2] + s[3]);
}

/* o : (m, n) = a : (m, k) times b : (k, n) */
INLINE void product(double *restrict o, const double *restrict a, const double *restrict b, int32_t m, int32_t k,
                    int32_t n)
{
    int32_t i, j, l;
    if (n == 1 && k == 4) {
        for (i = 0; i < m; i++, a += 4) o[i] = (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]);
    } else if (n == 1) {
        for (i = 0; i < m; i++) o[i] = dot(a + (int64_t)i * k, b, k);
    } else if (k == 3 && n == 4) {
        ROWS(3, 4, 0)
    } else if (k == 4 && n == 3) {
        ROWS(4, 3, 0)
    } else if (k == 4 && n == 4) {
        ROWS(4, 4, 0)
    } else {
        for (i = 0; i < m; i++, a += k, o += n) {
            for (j = 0; j < n; j++) o[j] = 0.0;
            for (l = 0; l < k; l++)
                for (j = 0; j < n; j++) o[j] += a[l] * b[(int64_t)l * n + j];
        }
    }
}

/* Such products, so many; of a, of b the same each time or, where it differs, the next. */
INLINE void products(double *restrict o, const double *restrict a, int32_t a_differs, const double *restrict b,
                     int32_t b_differs, int32_t count, int32_t rows, int32_t k, int32_t n)
{
    int32_t i, j, l, m = count;
    if (rows == 1 && a_differs && b_differs && k == 4 && n == 4) {
        ROWS(4, 4, 16)
    } else if (rows == 1 && a_differs && b_differs && k == 2 && n == 4) {
        ROWS(2, 4, 8)
    } else if (rows == 1 && a_differs && b_differs && k == 4 && n == 1) {
        ROWS(4, 1, 4)
    } else {
        for (i = 0; i < m; i++, o += rows * n, a += a_differs * rows * k, b += b_differs * k * n)
            product(o, a, b, rows, k, n);
    }
}

/* a : (n, n) becomes its inverse, by Gauss and Jordan with exchanged rows, which pivot : (n,) remembers. */
INLINE void inverse(double *a, double *pivot, int32_t n)
{
    int32_t i, j, k;
    for (k = 0; k < n; k++) {
        double *restrict const row = a + (int64_t)k * n;
        int32_t best = k;
        for (i = k + 1; i < n; i++)
            if (fabs(a[(int64_t)i * n + k]) > fabs(a[(int64_t)best * n + k])) best = i;
        pivot[k] = best;
        for (j = 0; j < n && best != k; j++) {
            const double x = row[j];
            row[j] = a[(int64_t)best * n + j];
            a[(int64_t)best * n + j] = x;
        }
        const double scale = 1.0 / row[k];
        row[k] = 1.0;
        for (j = 0; j < n; j++) row[j] *= scale;
        for (i = 0; i < n; i++) {
            double *restrict const other = a + (int64_t)i * n;
            const double factor = other[k];
            if (i == k) continue;
            other[k] = 0.0;
            for (j = 0; j < n; j++) other[j] -= factor * row[j];
        }
    }
    for (k = n - 1; k >= 0; k--) {
        const int32_t other = (int32_t)pivot[k];
        for (i = 0; i < n && other != k; i++) {
            const double x = a[(int64_t)i * n + k];
            a[(int64_t)i * n + k] = a[(int64_t)i * n + other];
            a[(int64_t)i * n + other] = x;
        }
    }
}

/* --- groups ---------------------------------------------------------------------------------------------------------- */

/* Some parts of one operation of a group: 8 words, of the operation, flags, width, out, three places, and one more. The
   flags from 8 on are of out and places that only the group uses, which have room for these parts alone. */
INLINE void part(const memory *m, const int32_t *w, int32_t from, int32_t many)
{
    const int32_t flags = w[1], width = w[2], all = many * width, k = w[7] >> 8, n = w[7] & 255;
    const int64_t skip = (int64_t)from * width, so = flags & 8 ? 0 : skip, sa = flags & 16 ? 0 : skip,
                  sb = flags & 32 ? 0 : skip, sc = flags & 64 ? 0 : skip;
    double *const o = placed(m, w[3]);
    const double *const a = placed(m, w[4]);
    if (w[0] == OP_gather) {
        const int32_t *const index = m->index + w[5] + skip;
        for (int32_t i = 0; i < all; i++) o[so + i] = a[index[i]];
    } else if (w[0] == OP_product) { /* rows times one matrix, or matrices of w[6] rows; flags: whether a, b differ */
        const int32_t tall = flags & 4, rows = tall ? 1 : w[6], one = (flags & 1) | !!tall, two = flags >> 1 & 1;
        products(o + so * rows * n, a + one * sa * rows * k, one, placed(m, w[5]) + two * sb * k * n, two, tall ? 1 : all,
                 tall ? all : rows, k, n);
    } else { /* flags: which operands are one number */
        const int va = !(flags & 1), vb = !(flags & 2), vc = !(flags & 4);
        const double *const x = a + (va ? sa : 0), *const y = placed(m, w[5]) + (vb ? sb : 0),
                     *const z = placed(m, w[6]) + (vc ? sc : 0);
        if (!simple(w[0], all, o + so, x, va, y, vb, z)) elementwise(w[0], all, o + so, x, va, y, vb, z, vc);
    }
}

/* Operations that are done together, some parts at once. */
INLINE void together(const memory *m, const int32_t *code, int32_t parts, int32_t at_once, int32_t count)
{
    for (int32_t from = 0; from < parts; from += at_once)
        for (int32_t k = 0; k < count; k++)
            part(m, code + 8 * k, from, parts - from < at_once ? parts - from : at_once);
}
PLAIN_AND_WIDE(group, together, (const memory *m, const int32_t *code, int32_t parts, int32_t at_once, int32_t count),
               (m, code, parts, at_once, count))

/* --- the rest ------------------------------------------------------------------------------------------------------- */

#define FOLD(expression)                                                                                               \
    for (i = 0; i + 4 <= n; i += 4)                                                                                    \
        for (j = 0; j < 4; j++) { const double x = a[i + j], y = s[j]; s[j] = (expression); bad[j] += x != x; }         \
    for (; i < n; i++) { const double x = a[i], y = s[0]; s[0] = (expression); bad[0] += x != x; }                      \
    for (j = 1; j < 4; j++) { const double x = s[j], y = s[0]; s[0] = (expression); bad[0] += bad[j]; }

/* The sum, the largest or the least of n numbers; NaN where one of them is. */
static double reduced(int32_t op, const double *a, int32_t n)
{
    double s[4], bad[4] = {0.0, 0.0, 0.0, 0.0};
    int32_t i, j;
    if (op == OP_sum && n == 4) return ((a[0] + a[1]) + a[2]) + a[3];
    for (j = 0; j < 4; j++) s[j] = op == OP_sum ? 0.0 : a[0];
    if (op == OP_sum) { FOLD(x + y) } else if (op == OP_largest) { FOLD(x > y ? x : y) } else { FOLD(x < y ? x : y) }
    return op == OP_sum || bad[0] == 0.0 ? s[0] : NAN;
}

/* The inverses of an operation: w of out, index, count, n, matrices. sized : by code of known size, where there is some. */
INLINE void inverses(const memory *m, const int32_t *w, int sized)
{
    const int32_t n = w[3], size = n * n;
    double *o = placed(m, w[0]), *const pivot = o + (int64_t)w[2] * size;
    memcpy(o, placed(m, w[4]), sizeof(double) * (size_t)w[2] * (size_t)size);
    for (int32_t i = 0; i < w[2]; i++, o += size) /* of elements, real or complex, and of others */
        if (sized && n == 4) inverse(o, pivot, 4); else if (sized && n == 8) inverse(o, pivot, 8); else inverse(o, pivot, n);
}
static void inverses_plain(const memory *m, const int32_t *w) { inverses(m, w, 0); }
WIDE_TARGET static void inverses_wide(const memory *m, const int32_t *w) { inverses(m, w, 1); }

/* One operation: w of out, index, sizes, operands and whether these are one number. Returns 0 where a guard fails. */
static int single(const memory *m, int32_t op, const int32_t *w, int wide)
{
    double *o = placed(m, w[0]);
    const int32_t *index = m->index + w[1];
    int32_t i, j;
    switch (op) {
    case OP_gather: {
        const double *const a = placed(m, w[3]);
        for (i = 0; i < w[2]; i++) o[i] = a[index[i]];
        break;
    }
    case OP_scatter: {
        const double *const a = placed(m, w[3]);
        for (i = 0; i < w[2]; i++) o[index[i]] = a[w[4] ? 0 : i];
        break;
    }
    case OP_sums: { /* sizes: targets, terms */
        const double *const a = placed(m, w[4]);
        for (i = 0; i < w[2]; i++) {
            double s = a[index[i]];
            for (j = index[i] + 1; j < index[i + 1]; j++) s += a[j];
            o[i] = s;
        }
        break;
    }
    case OP_product: /* sizes: count, m, k, n, whether a and b differ between these */
        products(o, placed(m, w[8]), w[6], placed(m, w[9]), w[7], w[2], w[3], w[4], w[5]);
        break;
    case OP_inverse: (wide ? inverses_wide : inverses_plain)(m, w); break;
    case OP_sum:
    case OP_largest:
    case OP_least: { /* sizes: of the result, terms of each */
        const double *const a = placed(m, w[4]);
        for (i = 0; i < w[2]; i++) o[i] = reduced(op, w[5] ? a : a + (int64_t)i * w[3], w[5] ? 1 : w[3]) * (op == OP_sum && w[5] ? w[3] : 1);
        break;
    }
    case OP_require: return *placed(m, w[3]) != 0.0;
    default: return 0;
    }
    return 1;
}

static int zero(const double *x, int32_t n)
{
    int32_t i = 0;
    while (i < n && x[i] == 0.0) i++;
    return i == n;
}

int run(const arterial_program *p, const memory *m, int phase)
{
    const int32_t *w = p->code + p->begin[phase], *const end = p->code + p->begin[phase + 1];
    while (w < end) {
        if (w[0] == OP_skip) { /* a block whose result is zero where some coefficients are: these, result, words */
            const int skipped = zero(placed(m, w[2]), w[3]);
            if (skipped) memset(placed(m, w[4]), 0, sizeof(double) * (size_t)w[5]);
            w += 7 + (skipped ? w[6] : 0);
        } else if (w[0] == GROUP) {
            (p->wide ? group_wide : group_plain)(m, w + 4, w[1], w[2], w[3]);
            w += 4 + 8 * w[3];
        } else {
            if (!single(m, w[0], w + 2, p->wide)) return 0;
            w += w[1];
        }
    }
    return 1;
}
