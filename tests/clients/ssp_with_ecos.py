"""Runs an SSP in ecos: ``ssp_with_ecos.py JOB.json`` prints the outputs after each step as JSON."""

import json
import sys

from answer import answer
from ecospy import EcosLib, EcosSimulation

job = json.load(open(sys.argv[1]))
EcosLib.set_log_level("warn")
table = []
with EcosSimulation(ssp_path=job["ssp"], step_size=job["step"]) as simulation:
    if not simulation.init(parameter_set=job["parameter_set"]):
        raise SystemExit(EcosLib.get_last_error())
    for _ in range(job["steps"]):
        simulation.step()
        table.append([simulation.get_real(name.replace(".", "::", 1)) for name in job["outputs"]])
    simulation.terminate()
print(json.dumps(table), file=answer, flush=True)
