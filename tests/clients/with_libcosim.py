"""Runs FMUs in libcosim: ``with_libcosim.py JOBS.json`` prints as JSON the outputs of each after each step."""

import json
import sys

from answer import answer
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave


def run(job):
    execution = CosimExecution.from_step_size(round(job["step"] * 1e9))  # ns
    slave = CosimLocalSlave(fmu_path=job["fmu"], instance_name="arteries")
    arteries = execution.add_local_slave(slave)
    variables = {v.name.decode(): v.reference for v in execution.slave_variables(arteries)}
    for name, (kind, value) in job["starts"].items():
        if not getattr(execution, f"{kind.lower()}_initial_value")(arteries, variables[name], value):
            raise SystemExit(f"libcosim does not take {name} = {value}")
    manipulator = CosimManipulator.create_override()
    observer = CosimObserver.create_last_value()
    execution.add_manipulator(manipulator)
    execution.add_observer(observer)
    outputs = [variables[name] for name in job["outputs"]]
    table = []
    for Q in job["inflow"]:
        manipulator.slave_real_values(arteries, [variables["inlet.Q"]], [Q])
        if not execution.step():
            raise SystemExit("libcosim: the step failed")
        table.append(observer.last_real_values(arteries, outputs))
    return table


log_output_level(CosimLogLevel.WARNING)
print(json.dumps([run(job) for job in json.load(open(sys.argv[1]))]), file=answer, flush=True)
