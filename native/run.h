/* A phase of a program on the memory of one member of a batch. */
#ifndef ARTERIAL_RUN_H
#define ARTERIAL_RUN_H

#include "engine.h"

typedef struct {
    const double *constant;
    double *fixed, *work;
    const int32_t *index;
    double *held; /* a block of what one phase makes, where a program has several */
} memory;

memory memory_of(const arterial_program *p, const double *fixed, double *work);

/* Where a program takes or leaves numbers; and n of them put there. */
double *place(const arterial_program *p, const memory *m, int which);
void put(const arterial_program *p, const memory *m, int which, const double *x, int32_t n);

/* Runs a phase; 0 where a guard fails. */
int run(const arterial_program *p, const memory *m, int phase);

/* Q and H at the end of a stage, from a guess in their places; 0 where it is not solved. guess : (n_Q + n_H) to begin
   from again. */
int solve(const arterial_program *p, const memory *m, double *guess);

#endif
