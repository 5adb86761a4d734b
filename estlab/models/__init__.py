"""Motion models and sensors. Units and geometry live here; filtering methods do not."""
