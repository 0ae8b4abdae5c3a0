"""Every threshold of a decision, fixed on tuning records before the reported run of benchmarks/hidden_effects.py.

Each comment states its basis: a derivation, a simulated error rate, or judgement. Numbers that only limit time, lay out
a report or define when sensors see an effect stand where they are used, and so do those by which
:mod:`discrepancy.find.plausibility` rejects a record.
"""

from __future__ import annotations

import math

from scipy.special import ndtri

from fitting.first.doubts import LOST as LOST  # of the mean pressure, on the way to a site
from fitting.first.doubts import SMALL as SMALL  # animals [kg], which lose more
from fitting.first.fitted import ACCURACY as ACCURACY  # of a first model, a fraction of the pulsation at each harmonic
from fitting.inference.model_discrepancy import PART as PART  # price of each nonzero part of a model error
from fitting.inference.unknown import OUTLIER as OUTLIER  # stated spreads

# --- the record ---
HELD_OUT = 0.25  # fraction of the beats, the last ones, that no fit uses: judgement
# false discovery rate on the z map (Benjamini-Yekutieli), and one-sided level of a fall of chi2: judgement
CHANCE = 0.05

# --- prior odds ---
# prices are -2 ln of prior odds: judgement, not fitted to the tuning records. 6 and 10 are where R. E. Kass and A. E.
# Raftery (J. Am. Stat. Assoc. 90, 1995, 773) begin strong and very strong evidence: odds of 1 : 20 and 1 : 150
FIRST = 6.0  # of a first effect, beside those of its name and place
# of a second effect. Model discrepancy, something that is not in the catalogue, costs as much with one part, because
# the bank has as many of either. In a network each place of a free term adds its own price
SECOND = 10.0

# --- the verdict ---
# candidates, and places of the map, with worse odds against the best are ruled out: by these odds, each of them is the
# truth in at most 1 % of records
RULED_OUT = 2.0 * math.log(100.0)  # of -2 ln evidence
# standard normal deviations from which a hypothesis does not explain the record. True hypotheses exceed it by chance in
# 0.13 % of records with known noise, in 0.25 % with the noise of 12 beats of a bench, and in 0.4 to 0.8 % for a network
# (simulated)
MISFIT = 3.0
# the same for several effects: 3.6, 4 and 5 to 6 %. It is stricter, as two terms can imitate much that is neither
MISFIT_SEVERAL = 1.8
# d' that each effect of a pair must have beside the other to be named (linear model, and in a network by refits). With
# it, chi2 of held-out beats falls by FALL in 97 % of records, by the formula below
VISIBLE = 12.0
BESIDE = 20.0  # alternative on a bench, by refits alone: judgement
# fraction of the gap that an effect must close to be named if more than noise remains, in the fit and on held-out
# beats: by definition of "most of it"
PART_CLOSED = 0.5
# limit of an outlier in root mean squares of the others of its kind, if above OUTLIER, with whose comment the simulated
# rates of both together stand
OUTLIER_OF_OTHERS = 5.0

# --- confidence ---
# upper limits of the confidence of a name, from a bank of records. Bench: 258 of the 265 most confident names of the
# bank of November 2026 (standard, sensors, varying; not fresh any more) were right; most of the others are laws outside
# the catalogue that it imitates. Network: what is ruled out is the truth at most so often; 300 names without an error
# give a 95 % bound of 1 %. Partial, and any name or `none` in a first model: judgement, for lack of records. If the
# comparison is incomplete or held-out beats refute a name: by definition no surer than not
SUREST = {"bench": 0.97, "network": 1.0 - math.exp(-0.5 * RULED_OUT), "partial": 2.0 / 3.0, "incomplete": 0.5}

# --- the FMU on held-out beats ---
# for an effect that the fitted three quarters of the beats show with d', chi2 falls by d'^2/3 +- 2 d'/sqrt(3): 47 % of
# effects with d' 6 do not pass, 11 % with 10, 0.4 % with 15
FALL = float(-ndtri(CHANCE))  # standard deviations by which chi2 must fall
# by definition: 1 is noise. A true model leaves less in half of the records, one that lacks an effect of d' 10 in 16 %
# (500 data), of d' 15 in 2 %
NO_GAP = 1.0
# of a pulse: a larger difference between an FMU and the model of the inference, or the solver, is an error of the
# program: judgement. It decides on warnings and on learned laws alone
AGREE = 1e-3

# --- effort of the search, which limits time ---
FEW = 6  # hypotheses refitted at a time
NEAR = 60.0  # score above the best within which hypotheses are refitted under sharper weights, with fresh derivatives
AFAR = 0.03  # model error, as a fraction of the pulse, under which laws start from the walls of the map
MOST_EFFECTS = 2  # of a hypothesis
