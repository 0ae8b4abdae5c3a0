"""Display of results in notebooks: HTML, data frames and figures. Not part of the FMU's code.

Only these modules use matplotlib, polars and pandas. The classes of results import them for display only.
"""
