"""The fields of disturbances, under the name that disturbances of users import; `octarm.fields`."""

from octarm.fields import PHASE as PHASE
from octarm.fields import Amount as Amount
from octarm.fields import Quantity as Quantity
from octarm.fields import Words as Words
from octarm.fields import field_defaults as field_defaults
from octarm.fields import field_keys as field_keys
from octarm.fields import field_kinds as field_kinds
