"""Networks: description and validation, files, and the coefficients of the equations."""
