"""Runs FMUs in ecos: ``with_ecos.py JOBS.json`` prints as JSON the outputs of each after each step."""

import json
import sys

from answer import answer
from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure


def run(job):
    with EcosSimulationStructure() as structure:
        structure.add_model("arteries", job["fmu"])
        structure.add_parameter_set(
            "starts", {f"arteries::{name}": value for name, (_, value) in job["starts"].items()}
        )
        with EcosSimulation(step_size=job["step"], structure=structure) as simulation:
            if not simulation.init(parameter_set="starts"):
                raise SystemExit(EcosLib.get_last_error())
            table = []
            for Q in job["inflow"]:
                simulation.set_real("arteries::inlet.Q", Q)
                simulation.step()
                table.append([simulation.get_real(f"arteries::{name}") for name in job["outputs"]])
            simulation.terminate()
    return table


EcosLib.set_log_level("warn")
print(json.dumps([run(job) for job in json.load(open(sys.argv[1]))]), file=answer, flush=True)
