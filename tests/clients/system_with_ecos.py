"""Runs a system in ecos: ``system_with_ecos.py JOB.json`` prints the outputs after each step as JSON.

ecos applies the parameter set whose name it is told.
"""

import json
import sys

from ecospy import EcosLib, EcosSimulation

job = json.load(open(sys.argv[1]))
EcosLib.set_log_level("warn")
names = ["::".join(name.split(".", 1)) for name in job["outputs"]]
with EcosSimulation(step_size=job["step"], ssp_path=job["ssp"]) as simulation:
    if not simulation.init(parameter_set="start"):
        raise SystemExit(EcosLib.get_last_error())
    table = []
    for _ in range(job["steps"]):
        simulation.step()
        table.append([simulation.get_real(name) for name in names])
    simulation.terminate()
print(json.dumps(table))
