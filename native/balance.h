/* Harmonic balance: the beat that repeats, as solver/periodic/harmonic_balance.py finds it, member by member. */
#ifndef ARTERIAL_BALANCE_H
#define ARTERIAL_BALANCE_H

#include "engine.h"

/* The phases after those of a step; in the order of solver/periodic/balance_program.py, as the places are. */
enum { ABOUT = PHASES, LINEARISE, MOMENT, FILL, REMEMBER, OBSERVE, RESPOND, RESPOND_MEAN, FILLED, RECALL, STORED,
       SCALED };
enum {
    IN_TAU, OUT_GUESS,                       /* START: length of the step; flows to begin with */
    IN_ABOUT_Y, IN_ABOUT_H, IN_TAU_WAVE,     /* ABOUT, LINEARISE */
    IN_NOW, OUT_LEFT, OUT_UNFILLED, OUT_UNREMEMBERED, OUT_OBSERVED, /* MOMENT to OBSERVE: see moment_parts */
    IN_DRIVEN, OUT_ANSWER, OUT_ANSWER_MEAN,  /* RESPOND, RESPOND_MEAN: changes of y and H */
    IN_FLOW_IN, OUT_CHANGE,                  /* FILLED: changes of A */
    IN_FORGOTTEN, OUT_MEMORIES, OUT_PAST,    /* RECALL: stress and history; what a stage needs of them */
    IN_LET_OUT, OUT_CHARGED,                 /* STORED: stored pressures */
    IN_ENTERS, OUT_SCALED,                   /* SCALED: what sources add to the equations of the nodes */
    BALANCE_PLACES
};

typedef struct {
    arterial_program p;
    int32_t n_held, n_now, n_left, n_unfilled, n_unremembered, n_memories, n_past, n_observed, n_stored; /* 0: none */
    int32_t at_stored, at_memories; /* where stored pressures, and stress and history, begin in a state */
    int32_t more[BALANCE_PLACES];
} arterial_balance;

/* What a period is made of: K harmonics beside the mean, their omega : (K + 1), cosines and sines : (K + 1, 2, K + 1) of
   2 pi j k / (4 K); stage : its length [s]. Amplitudes are (K + 1, 2, n), real parts and imaginary ones. */
typedef struct {
    const double *omega, *turn;
    double stage;
    int32_t K;
} arterial_period;

/* Whether it is made for so many places, and structures of these sizes. */
ARTERIAL_API int arterial_balance_fits(int32_t places, int32_t balance, int32_t period);

/* From y : (n_y), H : (n_H) to the steady state under given : (n_inlets), by steps of n lengths; 0 where there is none.
   guess : (n_Q + n_H). */
ARTERIAL_API int arterial_steady(const arterial_balance *b, const double *fixed, double *work, const double *given,
                                 const double *lengths, int32_t n, double *y, double *H, double *guess);

/* The Jacobians of waves of n frequencies about it, taus : (n, 2), into held : (n, n_held); 0 where one is singular. */
ARTERIAL_API int arterial_linearise(const arterial_balance *b, const double *fixed, double *work, const double *y,
                                    const double *H, const double *taus, int32_t n, double *held);

/* Answers : (n, S, 2, n_y + n_H) at these frequencies, the first of which is the mean, to S sources : (S, n_left) of
   momentum and of flow into the nodes. */
ARTERIAL_API void arterial_answer(const arterial_balance *b, const double *fixed, double *work, double *held,
                                  const double *sources, int32_t n, int32_t S, double *answers);

/* Numbers of scratch that the next ones need. */
ARTERIAL_API int64_t arterial_scratch(const arterial_balance *b, const arterial_period *period);

/* Corrections of the waves X : (K + 1, 2, n_y + n_H) until one is within the tolerance, or with of_first > 0 within
   this part of the first one, or as many as most; last : its size, infinite where they grew or did not end. drive :
   amplitudes, n_inlets. forced : n_left, and let_out : n_stored, or null. left : n_left, what the equations leave after
   the last one, or null; not written where last is infinite. Returns how many were made. */
ARTERIAL_API int32_t arterial_balanced(const arterial_balance *b, const arterial_period *period, const double *fixed,
                                       double *work, double *held, const double *drive, const double *forced,
                                       const double *let_out, double tolerance, double of_first, int32_t most,
                                       double *X, double *scratch, double *last, double *left);

/* Amplitudes : (K + 1, 2, n_report) of the outputs of waves X; whether all moments are physical. */
ARTERIAL_API int arterial_observed(const arterial_balance *b, const arterial_period *period, const double *fixed,
                                   double *work, const double *X, double *scratch, double *found);

#endif
