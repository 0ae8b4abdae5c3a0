"""Every number that decides on a record: where beats begin, which beats are used, what is noise, what is rejected.

"Simulated" names a rate that was counted on synthetic records; "by" a derivation. All others are judgement, held by
benchmarks/periods.py, none of whose recordings has a wrong period without a note, and by benchmarks/real_pressure.py.
Floors of rounding and resolutions of a search stand where they are used.
"""

from __future__ import annotations

import math

from solver.quantities.units import MMHG

# --- for all ---
FIVE_PERCENT = 1.645  # standard deviations, one-sided
SURE = 3.0  # standard deviations: chance reaches it in 0.13 %. So of a harmonic of the mean beat, of a sign test on
# whether beats differ in turn, and of what is not known of a seam
NEIGHBOURS = 3  # harmonics on either side that share one estimate of the noise
ORDINARY = (0.02, 0.98)  # quantiles: beyond them by the distance between them are spikes
NAMED = 3  # beats of a kind that a note names

# --- how far beats of one record may differ ---
NEAR = 0.1  # of a beat: one that is longer or shorter by more is not used, nor a given period so far off
UNSTEADY = NEAR / 2.0  # what is more is said, and is no strict period
ELASTIC = 1.5 * NEAR  # of a lag, by which a stretch may come early or late
# In 400 steady synthetic recordings of 20 to 50 dB, upstrokes stray by at most 0.1 % in 95 %. Simulated: they exceed
# VARIES in 1.5 % of the recordings, and the pulses exceed both VARIES and NO_PULSE in 1 %.
VARIES = NEAR / 5.0  # of the beat or the pulse: standard deviation, from which beats are cut singly; and of a period
# over the whole record, by which a given one may differ from the one of equal beats
OTHER_PULSE = 2.0 * NEAR  # of the pulse, by which it changes over the beats used if they are of no one state
RANGE = (0.05, 0.95)  # quantiles of a beat whose distance is its pulse: spikes are beyond them
NO_PULSE = 0.5  # of the noise over the pulse: more is no noise of a beat's range
UNLIKE, USUAL = 0.35, 6.0  # of the pulse, and times as much as usual: a beat that differs by both is not used
MISSING = 3  # such beats in a row that do not end a stretch
# times as much as usual, and of the pulse: a beat that differs by both is named. Hum of that part of the pulse is
# subtracted
ODD, VISIBLE = 5.0, 1e-3
FEWEST_BEATS = 5  # fewer say too little about the noise for a 95 % interval, and about which samples are spikes
FEWEST_SAMPLES = 8  # of a beat, and of a record

# --- the period ---
SHORTEST, LONGEST = 0.1, 1.0 / 0.3  # that are looked for [s]: heart rates of 10 and 0.3 Hz
FASTEST_HEART = 0.2  # [s]; hearts of rabbits and larger animals beat at 300 a minute at most
SCREENED = 64.0  # [s] of the record that the search looks at
WANDER = 0.25  # [Hz]; slower than any heart
# correlations, of those of the best lag, after which so much of the power goes on alike
GOES_ON = math.sqrt(0.75)  # a lag to judge; of beats with their mean, those of one heart
SAME = math.sqrt(0.9)  # beats that alternate, if they do; less is another part of a beat
# of a stretch with a later one: a channel with less has no beat, and white noise reaches 0.65. Of the usual likeness:
# what is less alike is no upstroke but an artefact, such as a sensor dead for some beats
HALF = math.sqrt(0.5)
IN_TURN = 1.5  # times the usual difference, from which beats may differ in turn: by 0.7 of its standard deviation
AS_MUCH = 4.0  # times less than the most is nearly as much: beats that are alike in turn are so after twice as many
# A pattern of four intervals may be a breath. It counts as one beat only if successive intervals differ by more than
# this many times the usual difference
MUCH = 10.0
UPSTROKES = 3  # of one beat, at most: a pattern of four may be a breath. Of a record, at least: two intervals
UNTIMELY = 3.0  # times as much as usual, by which every second or third comes off time, if by NEAR, too

# --- where a beat begins, in parts of the usual one ---
NEAREST = 0.6  # two beats are no closer
RESEMBLING = 0.5  # of the usual correlation with the mean beat, from which there is a beat
BEFORE, AFTER = 0.12, 0.28  # of the upstroke: the part of a beat that tells its time
ANOTHER = 1.0 - ELASTIC - BEFORE  # after the upstroke: the part that tells one beat from half of another
# by which an upstroke may come earlier or later than the mean beat says; and on either side, means whose difference is
# the rise: the one after a notch is shorter
SEARCHED = 0.08
FLAT_FOOT = 0.1  # of the steepest slope: where the foot is

# --- equal beats ---
IN_STEP = 1e-6  # samples that beats may slip against the samples over the whole record and be taken as they are
MOST_HARMONICS = 128  # of the harmonic model; what lies above is left to the residual
MOVED = 8  # harmonics above N/8, where half a sample is a sixteenth of a turn and more
JITTER = 0.5 * math.erfc(SURE / math.sqrt(2.0))  # of shifts as large without any (F test), below which they are taken
# out: by SURE

# --- spikes, and steps of a converter ---
FAR = 7.0  # robust standard deviations off the other beats and the neighbours
STEPS = 3.0  # of the converter: rounding, and what a median of rounded values adds
SLIP_OF_CUTS = 2.0  # samples by which a beat may be off the others where it was cut, its shape included
STEP_SHARE = 1e-3  # quantile of the steps between neighbours: the smallest may be an accident of rounding twice
STEP_WHOLE = 0.02  # of a step, by which a difference may miss a whole number of steps
STEP_NEAR = 8.0  # steps: differences that are compared with whole steps
STEP_FEWEST = 20  # of them. Simulated: of 400 analogue records of 20 to 1000 values none has a step
STEP_FINEST = 1e-5  # of the range: finer steps are of no converter
STEP_SURE = 0.1  # of a step: a harmonic of the mean beat that is larger is the signal's, not of rounding

# --- noise of the mean beat ---
MANY = 10  # beats that tell the noise of a low harmonic with fewer neighbours: 1/f noise is largest at k = 1
MOST_SERIAL = 0.9  # correlation of successive beats' means
MAX_HARMONICS = 40  # that a network is compared in, and that tell the timing of a beat
TAIL = 0.75  # of the Nyquist frequency: from here on harmonics tell what lies beyond it
BEATS_BEFORE, BEATS_UNKNOWN = 8, 3  # mean beats put before a record, and how many may have been larger or smaller
SEAM_ERROR = 0.3  # of the seam: the walls are not yet known, and the network is not linear
COHERENT, LOW = 0.5, 6  # of the variance of P that follows R at one of so many harmonics: beats differ, not sensors
HOLES = 0.01  # of the samples in gaps, from which phases are means of different beats: single spikes do no harm
LOOP_SHOWN = 5.0  # standard deviations, from which a harmonic tells the law of a loop
SAFE = 0.1  # of a harmonic that a filter leaves: to undo that makes ten times its noise, which the weights know
UNDONE = 1e-4  # a filter that leaves less is not undone: any flow is then within the noise over H

# --- stamps of time ---
LATEST = 1e10  # [s], times since 1970 included
LOST = 0.02  # of the steps: fewer wide ones are lost samples, for rates are within 2 % of what stamps show. And of an
# interval: nearer stamps are of one sample, and rates that differ by less need no low-pass
WIDE_STEP = 1.5  # steps: halfway between that of neighbours and that over a lost sample
# Of steps that are shorter than half or longer than 1.5 intervals, no sample lost: by 2 Q(0.5/(√2 0.21)) = 0.09 they
# are 10 % where stamps are off by 0.21 intervals (Gaussian). Beyond, which samples are lost is not seen. As large may
# the relative error of the rate be
IRREGULAR = 0.1

# --- sensors that are dead or clipped ---
FLAT = 1e-9  # of its size: a channel that varies by less is dead
PLATEAU = 4  # equal samples at the extreme that may be clipped
QUANTA = 12.0  # that a signal falls beside a plateau of a clipped channel; rounding alone makes fewer
VALVE = 0.05  # of its range, within which a flow may rest near zero: a closed valve, not a clipped sensor
WIDE = 0.03  # [m]; no radius but a pressure in the wrong column if the site's pressure is small

# of the pulse and standard deviations of the mean beat, within which its top counts as flat; times as long as that of a
# sinusoid. Simulated, 206 pressures and flows of the included networks, 30 beats, noise and steps of 0 to 3 % of the
# pulse: none of 3 296 is flat; with noise of 1 % and a tenth of the pulse cut off, 88 % of the pressures and 63 % of
# the flows
TOP, EXTREME, FLAT_TOP = 1e-3, 4.0, 2.0
SMOOTHED = 0.015  # of a beat: the mean over so much has less noise, and the same waves
NEGATIVE = 5.0  # values below zero that are expected where there is none: by chance, exp(-5)

# --- lines that are flushed, zeroed or calibrated ---
STILL, QUIET = 0.5, 0.05  # [s] in which a channel varies by less than this part of its usual range
ANY_BEAT = 2.0  # [s], of that range: longer than the beat of any heart above 30 a minute
BEYOND = 0.5  # of the range, by which a level lies outside what beats reach
STEEP_FOR, JUMP = 0.05, 0.5  # [s] in which a level is reached, from this part of the range away: a pulse falls slower
AROUND = 0.3  # [s] on either side that go with it: the line rings

# --- hum of the mains ---
MAINS, HUMS = (50.0, 60.0), 3  # [Hz], and its harmonics that are looked for
MAINS_OFF = 0.01  # of its frequency, by EN 50160, within which it is for 99.5 % of a year
# [s] in which hum may change. A Hann window of this length takes 97 % of hum that is 0.05 Hz off. It also takes what
# the beats have within 0.5 Hz of the line, which AS_MUCH limits to half of its amplitude. None of 1 600 simulated
# records with noise of 0.2 to 4 mmHg and without hum had such a line
HUM_FOLLOWED = 4.0

# --- what arteries of mammals have ---
HIGHEST_MEAN = 300.0 * MMHG  # mmHg read as kPa make any mean above 40 mmHg exceed it
PULSE = (2.0 * MMHG, 200.0 * MMHG)  # mmHg read as Pa make 15 to 150 mmHg 0.1 to 1.1
# kPa read as mmHg make means from 40 to 187 mmHg 5 to 25, where only lungs and veins have theirs. The ratio of pulse to
# mean knows no unit: 0.3 to 0.7 in systemic arteries, about 1 in those of the lungs. A pressure that is told from a
# reference, as the published sheep's, is all pulse.
LOW_MEAN, SYSTEMIC = 25.0 * MMHG, 0.75
RADIUS = (5e-5, 0.04)  # [m]
TO_R0 = 1.6  # mean radius over R0: an artery is stretched by less, and a diameter is twice its radius
WALL = (0.02, 0.5)  # h/R: 0.04 to 0.2 in arteries of mammals, so that a factor of 10 leaves it either way or nearly
STEEP = 6.0  # ratio of dP/dR to the model's: below the factor of the units, above what animals and effects differ by
LEVELS = (1.0, 50.0, 99.0)  # percentiles: lowest, mean and highest, whatever single samples are
FASTEST_FLOW = 5.0  # [m/s], of a peak flow over the area at R0

# --- a flow meter that is late or early ---
# Simulated: of 150 forks recorded at the root, with no delay, none is told (0 to 2.4 %; benchmarks/late_flow.py)
LATE_CLOSES = 0.7  # of what a model leaves of the pressure at the root: a delay that leaves more is not told
LATE_MATTERS = 0.05  # of the pulsation: nor is one where less is left without it
