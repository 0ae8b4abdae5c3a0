"""Runs a system in libcosim: ``system_with_libcosim.py JOB.json`` prints the outputs after each step as JSON."""

import json
import sys

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

job = json.load(open(sys.argv[1]))
log_output_level(CosimLogLevel.ERROR)
execution = CosimExecution.from_ssp_file(ssp_path=job["ssp"], step_size=round(job["step"] * 1e9))  # ns
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
places = []
for output in job["outputs"]:
    component, name = output.split(".", 1)
    slave = execution.slave_index_from_instance_name(component)
    places.append((slave, next(v.reference for v in execution.slave_variables(slave) if v.name.decode() == name)))
table = []
for _ in range(job["steps"]):
    if not execution.step():
        raise SystemExit("libcosim: the step failed")
    table.append([observer.last_real_values(slave, [reference])[0] for slave, reference in places])
print(json.dumps(table))
