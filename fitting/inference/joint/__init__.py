"""Several recordings of one subject as one record, and the calibration of a network from them."""
