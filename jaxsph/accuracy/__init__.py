"""What accuracy costs: a scene run at many settings, its error beside its time, and the settings to take.

`Study` runs a scene that has a reference; `Results` are its table, with file, picture and Pareto front; `cheapest` and
`best` read settings off it, and `recommend` finds those for a scene of one's own from a few short runs.
"""

from jaxsph.accuracy.choose import Choice, best, cheapest
from jaxsph.accuracy.recommend import Recommendation, recommend
from jaxsph.accuracy.results import Results, Row
from jaxsph.accuracy.settings import SETTINGS, grid
from jaxsph.accuracy.study import Study

__all__ = ["SETTINGS", "Choice", "Recommendation", "Results", "Row", "Study", "best", "cheapest", "grid", "recommend"]
