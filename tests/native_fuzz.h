/* Random numbers, counts and damaged resources of the fuzzing hosts, native_fuzz2.c and native_fuzz3.c.
 *
 * native_fuzzN FOLDER GUID SEED CALLS GIVEN OUTPUTS SCRATCH makes random calls to instances of an FMU that is linked
 * in: any order, any numbers, null pointers, states of other instances and freed ones, damaged bytes and resources.
 * Sanitizers, with which it is compiled, end it at the first fault. FOLDER : of the resources. GIVEN : how many inputs
 * and parameters there are, before the OUTPUTS. SCRATCH : a folder for damaged resources. Prints how many calls were
 * made, how many of them, of steps and of derivatives succeeded, and how many lines were logged.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MANY = 3, STATES = 8, MOST = 40 };
static uint64_t seed;
static long calls, lines;
static unsigned given, outputs;
static char broken[4096];
static char *whole;
static size_t size_of_whole;

/* Memory for so many values, beyond which a sanitizer sees, or none. */
#define LAST(count, values) (any(30) ? (values) + MOST - (count) : NULL)

static uint64_t any(uint64_t n)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (seed >> 11) % n;
}

static double number(void)
{
    static const double some[] = {0.0,   1.0,    -1.0,   1e-3, 2e-3,     1e-5,     3e6,
                                  1e300, -1e300, 1e-300, NAN,  INFINITY, -INFINITY};
    if (any(3)) return some[any(sizeof(some) / sizeof(*some))];
    return ldexp((double)any(1 << 20) - (1 << 19), (int)any(60) - 50);
}

/* A number of 64 bits that is small, near the ends of the types, or any. */
static int64_t whole_number(void)
{
    static const int64_t some[] = {0, 1, 2, 3, -1, INT32_MAX, INT32_MIN, INT64_MAX, INT64_MIN};
    return any(3) ? some[any(sizeof(some) / sizeof(*some))] : (int64_t)(any(UINT32_MAX) << 32 ^ any(UINT32_MAX));
}

/* By what a value is multiplied that is to be another, mostly allowed one. */
static double changed(void) { return any(2) ? 1.01 : ldexp(1.0, (int)any(17) - 8); }

static void arguments(int n, char **of)
{
    char name[4096];
    if (n != 8) exit(2);
    seed = strtoull(of[3], NULL, 10) * 2654435761u + 88172645463325252u;
    calls = strtol(of[4], NULL, 10);
    given = (unsigned)strtoul(of[5], NULL, 10), outputs = (unsigned)strtoul(of[6], NULL, 10);
    snprintf(broken, sizeof(broken), "%s", of[7]);
    snprintf(name, sizeof(name), "%s/arterial.bin", of[1]);
    FILE *const file = fopen(name, "rb");
    if (!file || fseek(file, 0, SEEK_END)) exit(2);
    size_of_whole = (size_t)ftell(file);
    whole = malloc(size_of_whole);
    rewind(file);
    if (!whole || fread(whole, 1, size_of_whole, file) != size_of_whole || fclose(file)) exit(2);
}

/* The scratch folder, with resources of which the end is missing, or a byte is another one. */
static const char *damaged(void)
{
    char name[sizeof(broken) + 16];
    const size_t kept = any(2) ? size_of_whole : any(any(2) ? size_of_whole : 200);
    const size_t at = any(any(2) ? size_of_whole : 200);
    snprintf(name, sizeof(name), "%s/arterial.bin", broken);
    FILE *const file = fopen(name, "wb");
    const char other = (char)(1 + any(255));
    whole[at] ^= other;
    if (!file || fwrite(whole, 1, kept, file) != kept || fclose(file)) exit(2);
    whole[at] ^= other;
    return broken;
}

static void summary(int fine, int steps, int derived)
{
    printf("%ld %d %d %d %ld\n", calls, fine, steps, derived, lines);
    free(whole);
}
