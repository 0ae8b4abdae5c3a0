"""Runs an FMU in ecos: ``with_ecos.py JOB.json`` prints the outputs after each step as JSON."""

import json
import sys

from answer import answer
from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

job = json.load(open(sys.argv[1]))
EcosLib.set_log_level("warn")
with EcosSimulationStructure() as structure:
    structure.add_model("arteries", job["fmu"])
    structure.add_parameter_set("starts", {f"arteries::{name}": value for name, (_, value) in job["starts"].items()})
    with EcosSimulation(step_size=job["step"], structure=structure) as simulation:
        if not simulation.init(parameter_set="starts"):
            raise SystemExit(EcosLib.get_last_error())
        table = []
        for Q in job["inflow"]:
            simulation.set_real("arteries::inlet.Q", Q)
            simulation.step()
            table.append([simulation.get_real(f"arteries::{name}") for name in job["outputs"]])
        simulation.terminate()
print(json.dumps(table), file=answer, flush=True)
