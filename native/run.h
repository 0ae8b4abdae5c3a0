/* A phase of a program on the memory of one member of a batch. */
#ifndef ARTERIAL_RUN_H
#define ARTERIAL_RUN_H

#include "engine.h"

typedef struct {
    const double *constant;
    double *fixed, *work;
    const int32_t *index;
} memory;

/* Runs a phase; 0 where a guard fails. */
int run(const arterial_program *p, const memory *m, int phase);

#endif
