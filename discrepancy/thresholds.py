"""Every number that decides: fixed on tuning records before the reported run of benchmarks/hidden_effects.py.

Each has a derivation, a simulated rate of error, or is judgement, and says which. What only bounds time, lays out a
report or says when sensors see an effect stands where it is used.
"""

from __future__ import annotations

import math

from scipy.stats import norm

from fitting.inference.model_discrepancy import PART as PART  # price of each part of an error of a bench's law

# --- the record ---
HELD_OUT = 0.25  # of the beats, the last ones, are kept from every fit: judgement
FEWEST_BEATS = 8  # judgement: of fewer, two held out would leave less than six, and no scatter to judge by
CHANCE = 0.05  # false rate of a discovery on the z map (Benjamini-Yekutieli) and of a fall of chi2, one-sided

# --- odds beforehand ---
# prices are -2 ln of odds beforehand: judgement, not fitted to the tuning records. 6 and 10 are where R. E. Kass and
# A. E. Raftery (J. Am. Stat. Assoc. 90, 1995, 773) begin strong and very strong evidence: odds of 1 : 20 and 1 : 150
FIRST = 6.0  # of a first effect, beside those of its name and place
SECOND = 10.0  # of a second effect
# of an error of the model, something that is not in the catalogue: one with one part costs as much as a second effect,
# as the bank holds as many of either. In a network each place of a free term costs its choice besides
ELSE = SECOND - PART

# --- the verdict ---
# candidates, and places of the map, whose odds against the best are worse than this are ruled out: by its odds, each of
# them is the truth in at most 1 % of records
CLASS_ODDS = 100.0
RULED_OUT = 2.0 * math.log(CLASS_ODDS)  # of -2 ln evidence
# standard normal deviations from which a hypothesis does not explain the record: of true ones 0.13 % reach that by
# chance where the noise is known, 0.25 % with that of 12 beats of a bench, and 0.4 to 0.8 % of a network (simulated)
MISFIT = 3.0
# the same for several effects together, 3.6, 4 and 5 to 6 %: two terms can imitate much that is neither
MISFIT_SEVERAL = 1.8
# d' that each of two effects must have beside the other to be named, linear: with it chi2 of held-out beats falls by
# FALL in 96 % of records, by the formula below
VISIBLE = 12.0
BESIDE = 20.0  # or by what the other alone leaves where it is refitted, on a bench: judgement
# of the gap that an effect must close to be named where more than noise remains, in the fit and to held-out beats: by
# definition of "most of it"
PART_CLOSED = 0.5
# a number of one artery or outlet that is farther from what all have in common is no deviation of this animal.
# Simulated with ten arteries and six outlets (36 numbers): 0.06 % of animals with the stated spreads have one, 2 % of
# those with 1.5 times and 6 % of those with 2.5 times these; beyond 4 spreads alone it would be 0.2, 24 and 98 %
OUTLIER = 4.0  # stated spreads
OUTLIER_OF_OTHERS = 5.0  # or root mean squares of the others of its kind, if that is more

# --- what is said ---
# No name is surer than a bank shows. Of a bench: 71 of the 75 surest names of tuning records were right, and 94 % of
# those of 588 earlier ones; the others are laws of no catalogue that one of it imitates. Of a network: of 300 names
# without a wrong one the 95 % bound is 1 %. Of a name beside which more remains: judgement, for want of records
SUREST = {"bench": 0.94, "network": 0.99, "partial": 2.0 / 3.0}
INCOMPLETE = 0.5  # confidence where not all could be compared, or a name was not borne out, at most: no surer than not

# --- the FMU on held-out beats ---
# with an effect that the fitted three quarters of the beats show with d', chi2 falls by d'^2/3 +- 2 d'/sqrt(3): 47 % of
# effects with d' 6 do not pass, 11 % with 10, 0.4 % with 15
FALL = float(norm.isf(CHANCE))  # standard deviations by which it must fall
# by definition: 1 is noise. A healthy model leaves less in half of the records, one with an effect of d' 10 and 500
# data in 16 %, of 15 in 2 %
NO_GAP = 1.0

# --- how far is searched: effort, which bounds time ---
FEW = 6  # hypotheses that are refitted at a time
NEAR = 60.0  # of a score above the best: hypotheses that are refitted under sharper weights, with fresh derivatives
AFAR = 0.03  # error of the model, in pulses, under which laws are begun at the walls of the map
BRANCHES = 3  # laws of each of two places that are tried together
MOST_EFFECTS = 2  # at once
