/* Reading the program and its constants from the FMU's resources. */
#include "component.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <wchar.h>
#endif

typedef struct {
    char magic[8];
    int32_t version, n_arrays;
    uint64_t size, digest; /* of the whole file; of all after this head */
} head;
typedef struct {
    int64_t at, count;
    int32_t kind, unused;
} entry;

enum { VERSION = 3 };
static const char MAGIC[8] = {'A', 'R', 'T', 'E', 'R', 'I', 'A', 'L'};
static const char FILE_NAME[] = "arterial.bin";
static const size_t SIZE[] = {1, sizeof(int32_t), sizeof(double)};

/* FNV-1a, eight bytes at once: files and states have whole ones. */
uint64_t digest(const void *bytes, size_t n)
{
    uint64_t h = 14695981039346656037u, word;
    for (size_t i = 0; i + 8 <= n; i += 8) {
        memcpy(&word, (const char *)bytes + i, 8);
        h = (h ^ word) * 1099511628211u;
        h ^= h >> 32;
    }
    return h;
}

#if defined(__wasi__)
/* In a page of the documentation there are no files: the page has the bytes (docs/live.js). */
__attribute__((import_module("page"), import_name("size"))) size_t page_size(void);
__attribute__((import_module("page"), import_name("read"))) void page_read(void *bytes);

static void *bytes_of(const char *path, size_t *size)
{
    void *const found = malloc(*size = page_size());
    (void)path;
    if (found) page_read(found);
    return found;
}
#else
static FILE *opened(const char *path)
{
#if defined(_WIN32)
    wchar_t wide[4096];
    size_t n = 0;
    for (const unsigned char *s = (const unsigned char *)path; *s && n < 4090;) {
        uint32_t code = *s++;
        int more = code >= 0xF0 ? 3 : code >= 0xE0 ? 2 : code >= 0xC0 ? 1 : 0;
        code &= more == 3 ? 0x07 : more == 2 ? 0x0F : more == 1 ? 0x1F : 0xFF;
        while (more-- && *s) code = code << 6 | (*s++ & 0x3F);
        if (code >= 0x10000) wide[n++] = (wchar_t)(0xD800 + ((code - 0x10000) >> 10));
        wide[n++] = (wchar_t)(code >= 0x10000 ? 0xDC00 + (code & 0x3FF) : code);
    }
    wide[n] = 0;
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

/* All bytes of a file, which the caller frees; NULL where it cannot be read. */
static void *bytes_of(const char *path, size_t *size)
{
    FILE *const file = opened(path);
    char *found = NULL;
    long n;
    if (!file) return NULL;
    if (!fseek(file, 0, SEEK_END) && (n = ftell(file)) >= 0 && !fseek(file, 0, SEEK_SET)) {
        found = malloc((size_t)n + 1);
        *size = (size_t)n;
        if (found && fread(found, 1, *size, file) != *size) {
            free(found);
            found = NULL;
        }
    }
    fclose(file);
    return found;
}
#endif

/* An array of a kind, and how many it has; NULL where there is none such. */
static const void *array(const resource *r, int32_t i, int32_t kind, int32_t *count)
{
    const entry *const e = (const entry *)((const char *)r->bytes + sizeof(head)) + i;
    if (count) *count = 0;
    if (i >= r->n_arrays || e->kind != kind) return NULL;
    if (count) *count = (int32_t)e->count;
    return (const char *)r->bytes + e->at;
}

static int whole(const void *bytes, size_t size)
{
    const head *const h = bytes;
    if (size < sizeof(head) || size % 8 || memcmp(h->magic, MAGIC, 8) || h->version != VERSION || h->size != size)
        return 0;
    if (h->n_arrays < PROGRAMS || (size_t)h->n_arrays > (size - sizeof(head)) / sizeof(entry)) return 0;
    if (digest((const char *)bytes + sizeof(head), size - sizeof(head)) != h->digest) return 0;
    const entry *e = (const entry *)(h + 1);
    for (int32_t i = 0; i < h->n_arrays; i++, e++)
        if (e->kind < 0 || e->kind > SOME_NUMBERS || e->at < 0 || e->at % 8 || e->count < 0 || e->count > INT32_MAX ||
            (uint64_t)e->at > size || (uint64_t)e->count > (size - (size_t)e->at) / SIZE[e->kind])
            return 0;
    return 1;
}

/* The program of derivatives, where there is one. */
static int derived(const resource *r, recorded *one, int32_t at)
{
    int32_t n, n_code, n_begin;
    const int32_t *const meta = array(r, at + DERIVED_META, SOME_INTEGERS, &n);
    one->derived.code = array(r, at + DERIVED_CODE, SOME_INTEGERS, &n_code);
    one->derived.begin = array(r, at + DERIVED_BEGIN, SOME_INTEGERS, &n_begin);
    one->derived.index = one->program.index;
    one->derived.constant = one->program.constant;
    if (!meta || !one->derived.code || !one->derived.begin) return 0;
    if (!n) return 1;
    if (n != 2 + D_PLACES || n_begin != D_PHASES + 1 || one->derived.begin[D_PHASES] != n_code) return 0;
    for (int k = 0; k < D_PLACES; k++)
        if (meta[2 + k] < 0) return 0;
    one->derived.n_fixed = meta[0];
    one->derived.n_work = meta[1];
    one->derived_places = meta + 2;
    return 1;
}

static int programs(resource *r)
{
    const int32_t wide = arterial_wide();
    for (int32_t i = 0; i < r->meta[N_PROGRAMS]; i++) {
        recorded *const one = &r->recorded[i];
        arterial_program *const p = &one->program;
        const int32_t at = PROGRAMS + PER_PROGRAM * i, *counts;
        int32_t n, n_begin, n_code;
        p->wide = one->derived.wide = wide;
        one->meta = array(r, at + PROGRAM_META, SOME_INTEGERS, &n);
        p->code = array(r, at + CODE, SOME_INTEGERS, &n_code);
        p->begin = array(r, at + BEGIN, SOME_INTEGERS, &n_begin);
        p->index = array(r, INDEX, SOME_INTEGERS, NULL);
        p->constant = array(r, NUMBERS, SOME_NUMBERS, NULL);
        if (!one->meta || !p->code || !p->begin || !p->index || !p->constant) return 0;
        if (r->meta[N_ARITHMETIC]) {
            if (!arithmetic_read(r, one, n, n_begin) || p->begin[n_begin - 1] != n_code) return 0;
            p->n_fixed = one->meta[N_FIXED];
            p->n_work = one->meta[N_WORK];
            continue;
        }
        if (n != AT_PLACES + PLACES + FURTHER + r->n_inlets + 2 * one->meta[N_MARGINS]) return 0;
        if (n_begin != SHOW + 2 || p->begin[SHOW + 1] != n_code) return 0;
        counts = one->meta + COUNTS;
        int32_t *const to[N_COUNTS] = {&p->n_fixed, &p->n_work, &p->n_y, &p->n_A, &p->n_Q,
                                       &p->at_Q, &p->n_H, &p->n_inlets, &p->n_outlets, &p->n_report, &p->n_sources};
        for (n = 0; n < N_COUNTS; n++) *to[n] = counts[n];
        memcpy(p->place, one->meta + AT_PLACES, PLACES * sizeof(int32_t));
        one->further = one->meta + AT_PLACES + PLACES;
        for (n = 0; n < PLACES; n++) /* every place is one; but what no program reads, and margins that it has not */
            if (p->place[n] < 0) return 0;
        for (n = OUT_Y_REST; n < FURTHER; n++)
            if (one->further[n] < 0 && (n < OUT_MARGINS + one->meta[N_MARGINS] || n >= OUT_MARGINS + MOST_MARGINS))
                return 0;
        if (!derived(r, one, at)) return 0;
        one->first = one->further + FURTHER;
        one->reasons = one->first + r->n_inlets;
    }
    return 1;
}

int resource_read(resource *r, const char *folder, char *why, size_t room)
{
    const size_t length = strlen(folder);
    char *const path = malloc(length + sizeof(FILE_NAME) + 1);
    size_t size = 0;
    int32_t n, m;
    memset(r, 0, sizeof(*r));
    if (!path) return snprintf(why, room, "no memory."), 0;
    snprintf(path, length + sizeof(FILE_NAME) + 1, "%s%s%s", folder,
             length && strchr("/\\", folder[length - 1]) ? "" : "/", FILE_NAME);
    r->bytes = bytes_of(path, &size);
    if (!r->bytes) {
        snprintf(why, room, "%.700s: cannot be read; unpack the whole FMU and give the path of its resources.", path);
        return free(path), 0;
    }
    free(path);
    if (whole(r->bytes, size)) {
        r->n_arrays = ((const head *)r->bytes)->n_arrays;
        r->meta = array(r, META, SOME_INTEGERS, &n);
        const char *const operations = array(r, OPERATIONS, SOME_BYTES, NULL);
        r->guid = array(r, GUID, SOME_BYTES, NULL);
        r->variables = array(r, VARIABLES, SOME_INTEGERS, NULL);
        r->ranges = array(r, RANGES, SOME_NUMBERS, NULL);
        r->strings = array(r, STRINGS, SOME_BYTES, NULL);
        r->parameters = array(r, PARAMETERS, SOME_INTEGERS, &r->n_parameters);
        r->inlets = array(r, INLETS, SOME_INTEGERS, &r->n_inlets);
        r->inlet_numbers = array(r, INLET_NUMBERS, SOME_NUMBERS, NULL);
        r->curves = array(r, CURVES, SOME_NUMBERS, NULL);
        r->venous = array(r, VENOUS, SOME_INTEGERS, &r->n_outlets);
        r->segments = array(r, SEGMENTS, SOME_INTEGERS, &r->n_segments);
        r->elements = array(r, ELEMENTS, SOME_INTEGERS, &r->n_elements);
        r->positions = array(r, POSITIONS, SOME_NUMBERS, NULL);
        r->sources = array(r, SOURCES, SOME_INTEGERS, &r->n_sources);
        r->source_periods = array(r, SOURCE_PERIODS, SOME_NUMBERS, NULL);
        r->periodic = array(r, PERIODIC, SOME_NUMBERS, &r->n_periodic);
        r->n_inlets /= PER_INLET;
        r->n_outlets /= PER_VENOUS;
        r->n_segments /= PER_SEGMENT;
        r->n_sources /= PER_SOURCE;
        m = r->meta && n == N_META ? r->meta[N_PROGRAMS] : 0;
        if (m > 0 && m <= (r->n_arrays - PROGRAMS) / PER_PROGRAM && r->positions && r->strings && r->variables &&
            operations && arterial_fits(operations, PLACES, (int32_t)sizeof(arterial_program), "")) {
            r->recorded = calloc((size_t)m, sizeof(recorded));
            if (r->recorded && programs(r)) {
                const int32_t own = r->meta[N_ARITHMETIC];
                r->n_state = own ? own : arterial_state_size(&r->recorded->program);
                return 1;
            }
        }
    }
    resource_free(r);
    snprintf(why, room, "%s: damaged, or of another version of this FMU; build the FMU anew.", FILE_NAME);
    return 0;
}

void resource_free(resource *r)
{
    free(r->recorded);
    free(r->bytes);
    memset(r, 0, sizeof(*r));
}
