"""A search for gains that takes a second."""

from octarm.sweeps.scenarios import EVALUATION
from octarm.sweeps.tune import Budget
from octarm.sweeps.tune_cost import Examination

TINY = Examination(begin=0.02, duration=0.06)
BUDGET = Budget(
    population=5,
    generations=4,
    finalists=2,
    short=TINY,
    long=Examination(begin=0.03, duration=0.1),
    unseen=Examination(scenarios=EVALUATION, begin=0.02, duration=0.06),
)
