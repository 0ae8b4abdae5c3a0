"""Every number that decides: fixed on tuning records before the reported run of benchmarks/hidden_effects.py."""

from __future__ import annotations

import math

from fitting.inference.misfit import PART as PART
from fitting.inference.network_record import STEP_DT as STEP_DT

# of the forward models: harmonics and steps of the simulations, and the width of the prior of an effect's size
from fitting.inference.simulator import HARMONICS_BEYOND as HARMONICS_BEYOND
from fitting.inference.terms import PRIOR_WIDTH as PRIOR_WIDTH

# --- the record ---
HELD_OUT = 0.25  # of the beats, the last ones, are kept from every fit
FEWEST_BEATS = 8  # fewer leave no scatter to judge by once some are held out

FEW = 6  # that are worth a closer look: hypotheses that are refitted at a time, entries of the z map that are listed

# --- find ---
FALSE_DISCOVERIES = 0.05  # Benjamini-Yekutieli, over all entries of the z map

# --- name ---
# largest log-odds that count, and shift and slope of those that are stated: of the bench by logistic regression on 588
# names of tuning records; of networks by judgement, which names of tuning seed 20310123 bore out to 0.02; of partial
# answers by judgement, for want of records
RELIABILITY = {"bench": (2.5, 0.23, 0.96), "network": (4.5, 0.0, 1.0), "partial": (3.5, 0.0, 0.2)}
# prices are -2 ln of odds beforehand: judgement, not fitted to the tuning records. 6 and 10 are where R. E. Kass and
# A. E. Raftery (J. Am. Stat. Assoc. 90, 1995, 773) begin strong and very strong evidence: odds of 1 : 20 and 1 : 150.
# An error of a bench's law with one part costs as much as a second effect: the bank holds as many of either. In a
# network each place of a free term costs its choice besides
FIRST = 6.0  # price of a first effect: -2 ln of its odds beforehand, beside those of its name and place
SECOND = 10.0  # price of a second effect
ELSE = 8.0  # price of an error of the model: something that is not in the catalogue
# of the gap that an effect must close to be named where more than noise remains: in the fit, and to held-out beats
PART_CLOSED = 0.5
INCOMPLETE = 0.5  # confidence where not all could be compared, at most
CLASS_ODDS = 100.0  # candidates, and places of the map, whose odds against the best are worse than this are ruled out
RULED_OUT = 2.0 * math.log(CLASS_ODDS)  # of -2 ln evidence
# standard normal deviations from which a hypothesis does not explain the record: of true ones 0.13 % reach that by
# chance where the noise is known, 0.25 % with that of 12 beats of a bench, and 0.4 to 0.8 % of a network (simulated)
MISFIT = 3.0
# the same for several effects together, 3.6, 4 and 5 to 6 %: two terms can imitate much that is neither
MISFIT_SEVERAL = 1.8
NEAR = 60.0  # of a score above the best: hypotheses that are refitted under sharper weights, with fresh derivatives
MOST_EFFECTS = 2  # at once
MAPPED = 0.6  # of the time limit, at most, which the source map may take
LEARNING = 0.3  # of the time limit, which learning a law may take although it is over
BRANCHES = 3  # laws of each of two places that are tried together
NO_SIZE = 0.05  # of x: an effect smaller than that did not lower the cost itself
AFAR = 0.03  # error of the model, in pulses, under which laws are begun at the walls of the map
VISIBLE = 12.0  # d' that each of two effects must have beside the other to be named, linear
BESIDE = 20.0  # or by what the other alone leaves where it is refitted
INVISIBLE = 3.0  # d' of a typical effect below which sensors cannot see it
INSEPARABLE = 6.0  # d' between two typical effects below which sensors cannot tell them apart
BEYOND = 2.0  # stated spreads from what all arteries have in common, from which one is said to be odd
# a number of one artery or outlet that is farther from what all have in common is no deviation of this animal.
# Simulated with ten arteries and six outlets (36 numbers): 0.06 % of animals with the stated spreads have one, 2 % of
# those with 1.5 times and 6 % of those with 2.5 times these; beyond 4 spreads alone it would be 0.2, 24 and 98 %
OUTLIER = 4.0  # stated spreads
OUTLIER_OF_OTHERS = 5.0  # or root mean squares of the others of its kind, if that is more
DETECTABLE = 5.0  # d' of the smallest detectable size: named half the time or more

# --- show ---
# one-sided 5 %: so often passes a name with which chi2 does not fall. With an effect that the fitted three quarters of
# the beats show with d', it falls by d'^2/3 +- 2 d'/sqrt(3): 47 % of effects with d' 6 do not pass, 11 % with 10, 0.4 %
# with 15
FALL = 1.645  # standard deviations by which chi2 of the FMU on held-out beats must fall
# a healthy model leaves less in half of the records, one with an effect of d' 10 and 500 data in 16 %, of 15 in 2 %
NO_GAP = 1.0  # times the noise: a gap to held-out beats that leaves nothing to name
