"""The loop of the particle filter with compiled work on clouds."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from estlab.filters.compiled_particles import CompiledParticleFilter
from estlab.filters.loop import Loop
from estlab.filters.particle_code import CompiledDraws, ParticleCode
from estlab.maths.streams import Draws
from estlab.record import Estimates, Record
