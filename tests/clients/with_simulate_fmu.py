"""Runs an FMU by FMPy's simulate_fmu: ``with_simulate_fmu.py JOB.json`` prints the outputs after each step as JSON."""

import json
import sys

import numpy as np
from answer import answer
from fmpy import simulate_fmu

job = json.load(open(sys.argv[1]))
n = len(job["inflow"])
inflow = np.zeros(n, dtype=[("time", float), ("inlet.Q", float)])
inflow["time"] = np.arange(n) * job["step"]
inflow["inlet.Q"] = job["inflow"]
result = simulate_fmu(
    job["fmu"],
    stop_time=n * job["step"],
    output_interval=job["step"],
    input=inflow,
    output=job["outputs"],
    start_values={name: value for name, (_, value) in job["starts"].items()},
)
print(
    json.dumps([[float(result[name][i]) for name in job["outputs"]] for i in range(1, n + 1)]), file=answer, flush=True
)
