"""A network in a notebook, drawn from left to right."""

from fitting.pages.network_drawing import figure as figure
