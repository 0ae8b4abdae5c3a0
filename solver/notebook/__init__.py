"""What a notebook shows of a result: HTML, data frames and figures. Not part of the FMU's code.

Only these modules know matplotlib, polars and pandas. The classes of results import them when they are asked to show
themselves.
"""
