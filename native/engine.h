/* Array programs, as solver/tracing/program.py writes them, and the implicit steps that they make. */
#ifndef ARTERIAL_ENGINE_H
#define ARTERIAL_ENGINE_H

#include <stdint.h>

#if defined(_WIN32)
#define ARTERIAL_API __declspec(dllexport)
#else
#define ARTERIAL_API __attribute__((visibility("default")))
#endif

/* The phases of a program: each depends on those before it. */
enum { BIND, PREPARE, START, CORRECT, FINITE, REFRESH, CORRECT_FRESH, END, CHECK, REPORT, PHASES };

/* Where programs take and leave their numbers; in the order of NAMES in solver/tracing/native.py. */
enum {
    IN_Y, IN_H0, IN_DRIVE, IN_VENOUS,              /* PREPARE: the state at the start of the step, what drives it */
    OUT_BEGUN, OUT_GIVEN, OUT_SMALL_Q, OUT_SMALL_H,
    IN_START, IN_GIVEN,                            /* START */
    IN_Q, IN_H,                                    /* all from CORRECT to END: an iterate */
    OUT_Q, OUT_DH, OUT_CHANGE_Q, OUT_CHANGE_H,     /* CORRECT */
    FRESH_Q, FRESH_DH, FRESH_CHANGE_Q, FRESH_CHANGE_H,
    OUT_FINITE, OUT_END, OUT_A_T, OUT_MARGIN,      /* FINITE, END, CHECK */
    IN_Y_REPORT, IN_A_T_REPORT, IN_H_REPORT, OUT_REPORT,
    IN_G_BEGIN, IN_G, IN_G_REPORT,                 /* PREPARE, START, REPORT: what tables of sources give */
    PLACES
};

typedef struct {
    const int32_t *code, *begin, *index;
    const double *constant;
    int32_t n_fixed, n_work;
    int32_t n_y, n_A, n_Q, at_Q, n_H; /* numbers of a state, of its A (which come first) and Q, where Q begins; nodes */
    int32_t n_inlets, n_outlets, n_report, n_sources;
    int32_t place[PLACES];
    int32_t wide; /* arterial_wide() */
} arterial_program;

/* Whether the processor has vectors of four numbers that the engine can use: AVX2. */
ARTERIAL_API int32_t arterial_wide(void);

/* Whether it is made for these operations, in the order of their codes, so many places, a program of this size, and of
   the sources with this digest, if it is not "". */
ARTERIAL_API int arterial_fits(const char *operations, int32_t places, int32_t program, const char *sources);

/* What the numbers of a parameter set make: the first phase. */
ARTERIAL_API int arterial_bind(const arterial_program *p, double *fixed, double *work);

/* Numbers of a state: y, A_t, H, and the unknowns of the last two steps. */
ARTERIAL_API int32_t arterial_state_size(const arterial_program *p);

/* n steps of length dt of B members. fixed : (B, n_fixed). state, spare : (B, state size). work : n_work +
   3 n_y + 2 n_Q + n_H. drive : (n, n_inlets, 4, B or 1, as own_drive says). venous : (B, n_outlets). acting :
   (n, 4, n_sources) what tables give at the start and at the stages of each step. table : (n, B, n_report). Returns how many steps were made: fewer where a member stopped, in the state before. */
ARTERIAL_API int32_t arterial_steps(const arterial_program *p, int32_t n, int32_t B, double dt, const double *fixed,
                                    double *state, double *spare, double *work, const double *drive, int own_drive,
                                    const double *venous, const double *acting, double *table);

#endif
