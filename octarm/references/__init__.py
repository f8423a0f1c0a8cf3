"""Desired motions, by name or made of parts; `REFERENCES` has those with a name."""

from octarm.references.catalogue import REFERENCES as REFERENCES
from octarm.references.catalogue import is_built_in as is_built_in
from octarm.references.catalogue import named_reference as named_reference
from octarm.references.catalogue import parameters_of as parameters_of
from octarm.references.catalogue import recorded_word as recorded_word
from octarm.references.motions import REAL as REAL
from octarm.references.motions import Chirp as Chirp
from octarm.references.motions import MultiSine as MultiSine
from octarm.references.motions import SetPoint as SetPoint
from octarm.references.motions import SetPoints as SetPoints
from octarm.references.motions import Sine as Sine
from octarm.references.motions import SmoothStep as SmoothStep
from octarm.references.motions import Spline as Spline
from octarm.references.motions import wanted as wanted
from octarm.references.named import Hanging as Hanging
from octarm.references.named import NamedReference as NamedReference
