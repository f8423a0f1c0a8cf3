"""A search for gains that takes half a second, in two control periods."""

from octarm.sweeps.scenarios import EVALUATION, SCENARIOS, Examination
from octarm.sweeps.tune import Budget

FEW = (SCENARIOS[3], SCENARIOS[8], SCENARIOS[12])
TINY = Examination(scenarios=FEW, begin=0.02, duration=0.06)
BUDGET = Budget(
    population=5,
    generations=4,
    finalists=2,
    short=TINY,
    long=Examination(scenarios=FEW, begin=0.03, duration=0.1),
    unseen=Examination(scenarios=EVALUATION[1::2], begin=0.02, duration=0.06),
)
