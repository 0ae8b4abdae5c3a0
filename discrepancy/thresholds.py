"""Every number that decides: fixed on tuning records before the reported run of benchmarks/hidden_effects.py."""

from __future__ import annotations

# of the forward models: steps of the simulations, and the width of the prior of an effect's size
from fitting.inference.network import COARSE_DT as COARSE_DT
from fitting.inference.network import SCREEN_DT as SCREEN_DT
from fitting.inference.terms import PRIOR_WIDTH as PRIOR_WIDTH

# --- the record ---
HELD_OUT = 0.25  # of the beats, the last ones, are kept from every fit
FEWEST_BEATS = 8  # fewer leave no scatter to judge by once some are held out

# --- find ---
FALSE_DISCOVERIES = 0.05  # Benjamini-Yekutieli, over all entries of the z map
LOUDEST = 8  # entries of the z map that the verdict lists

# --- name ---
FAR_OFF = 20.0  # misfit of the model as given from which on nothing depends on its last digits
BIC_NONE = 6.0  # by which a candidate must beat "none", its share of the prior included
CLASS_ODDS = 100.0  # candidates whose odds against the best are worse than this are ruled out
MISFIT = 2.3  # standard normal deviations of the misfit statistic from which a hypothesis does not explain the record
MISFIT_SEVERAL = 1.3  # the same for several effects together: two terms can imitate much that is neither
NEAR = 60.0  # of a score above the best: hypotheses that are refitted with shorter steps and fresh derivatives
MOST_EFFECTS = 2  # at once
BRANCHES = 3  # hypotheses that a further effect is added to
BRANCH_COST = 3.0  # of the best cost, above which none is added
SECOND = 10.0  # by which a second effect must lower the BIC
SOMETHING_ELSE = 0.1  # odds beforehand of an effect outside the catalogue, against the best candidate
NO_SIZE = 0.05  # of x: an effect smaller than that did not lower the cost itself
SHORTLIST = 14  # candidates that are refitted
PROMISING = 0.2  # of the best promised gain, which is linear, that a candidate must promise to be refitted
FEWEST = 4  # effects that are refitted whatever they promise
INVISIBLE = 3.0  # d' of a typical effect below which sensors cannot see it
INSEPARABLE = 6.0  # d' between two typical effects below which sensors cannot tell them apart
DETECTABLE = 5.0  # d' of the smallest detectable size: named half the time or more
