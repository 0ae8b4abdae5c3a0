"""Runs FMUs in FMPy, call by call: ``with_fmpy.py JOBS.json`` prints as JSON the outputs of each after each step."""

import json
import sys

import fmpy
from answer import answer


def run(job):
    description = fmpy.read_model_description(job["fmu"])
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    unzipped = fmpy.extract(job["fmu"], job["folder"])
    slave = fmpy.instantiate_fmu(unzipped, description, fmi_type="CoSimulation")
    slave.setupExperiment(startTime=0.0)
    for name, (kind, value) in job["starts"].items():
        getattr(slave, f"set{kind}")([references[name]], [value])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    outputs = [references[name] for name in job["outputs"]]
    table = []
    for i, Q in enumerate(job["inflow"]):
        slave.setReal([references["inlet.Q"]], [Q])
        slave.doStep(i * job["step"], job["step"])
        table.append(slave.getReal(outputs))
    slave.terminate()
    slave.freeInstance()
    return table


print(json.dumps([run(job) for job in json.load(open(sys.argv[1]))]), file=answer, flush=True)
