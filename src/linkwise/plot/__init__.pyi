"""The public figures, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.plot.absorptions import absorption as absorption
from linkwise.plot.absorptions import crossings as crossings
from linkwise.plot.absorptions import designs as designs
from linkwise.plot.absorptions import energy as energy
from linkwise.plot.absorptions import map as map
from linkwise.plot.discoveries import departures as departures
from linkwise.plot.discoveries import evidence as evidence
from linkwise.plot.discoveries import path as path
from linkwise.plot.discovery_graph import graph as graph
from linkwise.plot.estimates import residuals as residuals
from linkwise.plot.estimates import shapes as shapes
from linkwise.plot.levels import acceleration_surface as acceleration_surface
from linkwise.plot.levels import distortion as distortion
from linkwise.plot.levels import level_modes as level_modes
from linkwise.plot.levels import level_response as level_response
from linkwise.plot.levels import ring_down as ring_down
from linkwise.plot.links import force as force
from linkwise.plot.links import force_comparison as force_comparison
from linkwise.plot.links import force_errors as force_errors
from linkwise.plot.links import loop as loop
from linkwise.plot.links import surface as surface
from linkwise.plot.records import coherence as coherence
from linkwise.plot.records import displacement as displacement
from linkwise.plot.records import histories as histories
from linkwise.plot.records import spectrogram as spectrogram
from linkwise.plot.records import spectrum as spectrum
from linkwise.plot.responses import backbone as backbone
from linkwise.plot.responses import response as response
from linkwise.plot.studies import study as study
from linkwise.plot.studies import success_map as success_map
from linkwise.plot.style import save as save
from linkwise.plot.validations import prediction as prediction
from linkwise.plot.validations import prediction_error as prediction_error
from linkwise.plot.validations import prediction_profile as prediction_profile
from linkwise.plot.validations import prediction_spectrum as prediction_spectrum

__all__: list[str]
