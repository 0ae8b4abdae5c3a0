/* A phase of a program on the memory of one member of a batch. */
#ifndef ARTERIAL_RUN_H
#define ARTERIAL_RUN_H

#include "engine.h"

/* A function twice: for every processor, and for those of arterial_wide(), to which the same operations give the same
   numbers: no multiplication is fused with an addition. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif
#if defined(__GNUC__) && defined(__x86_64__)
#define WIDE_TARGET __attribute__((target("avx2")))
#else
#define WIDE_TARGET
#endif
#define PLAIN_AND_WIDE(name, body, parameters, arguments)                                                              \
    static void name##_plain parameters { body arguments; }                                                            \
    WIDE_TARGET static void name##_wide parameters { body arguments; }

typedef struct {
    const double *constant;
    double *fixed, *work;
    const int32_t *index;
    double *held; /* a block of what one phase makes, where a program has several */
} memory;

#if defined(__GNUC__) && !defined(_WIN32) /* else a host's function of the same name, as step of glibc, takes our place */
#pragma GCC visibility push(hidden)
#endif
memory memory_of(const arterial_program *p, const double *fixed, double *work);
/* Where a program takes or leaves numbers; and n of them put there. */
double *place(const arterial_program *p, const memory *m, int which);
void put(const arterial_program *p, const memory *m, int which, const double *x, int32_t n);
/* Runs a phase; 0 where a guard fails. */
int run(const arterial_program *p, const memory *m, int phase);
/* Numbers at an address. */
INLINE double *placed(const memory *m, int32_t address)
{
    double *const base[4] = {(double *)m->constant, m->fixed, m->work, m->held};
    return base[address & 3] + (address >> 2);
}

enum { STAGES = 3 };
extern const double SDIRK3[STAGES][STAGES];

/* A step of one member, from its state to after, with what drives it in its places: 1; 0 where it is not solved, -1 where
   it is not physical. acting : (4, n_sources) what tables give at its start and at its stages. */
int step(const arterial_program *p, const memory *m, double dt, const double *state, double *after, const double *acting);
/* The flows before the last correction. */
double *last_but_one(const arterial_program *p, const memory *m);
/* The outputs of a state, when tables give what is acting : (n_sources). */
void report(const arterial_program *p, const memory *m, const double *state, double *row, const double *acting);

/* Q and H at the end of a stage, from a guess in their places; 0 where it is not solved. guess : (n_Q + n_H) to begin
   from again. */
int solve(const arterial_program *p, const memory *m, double *guess);
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif
#endif
