"""From a composed configuration to objects, and what may be expected of a run."""
