"""Runs an SSP in libcosim: ``ssp_with_libcosim.py JOB.json`` prints the outputs after each step as JSON."""

import json
import sys

from answer import answer
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

job = json.load(open(sys.argv[1]))
log_output_level(CosimLogLevel.WARNING)
execution = CosimExecution.from_ssp_file(ssp_path=job["ssp"], step_size=round(job["step"] * 1e9))  # ns
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
references = {}
for slave in execution.slave_infos():
    for variable in execution.slave_variables(slave.index):
        references[f"{slave.name.decode()}.{variable.name.decode()}"] = slave.index, variable.reference
table = []
for _ in range(job["steps"]):
    if not execution.step():
        raise SystemExit("libcosim: the step failed")
    row = []
    for name in job["outputs"]:
        slave, reference = references[name]
        row += observer.last_real_values(slave, [reference])
    table.append(row)
print(json.dumps(table), file=answer, flush=True)
