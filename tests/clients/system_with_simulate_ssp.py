"""Runs a system in FMPy: ``system_with_simulate_ssp.py JOB.json`` prints the outputs after each step as JSON.

simulate_ssp applies no parameter set by itself; one that read_ssv read has texts, and names without their component.
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZipFile

from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import ParameterSet, read_ssd, read_ssv

job = json.load(open(sys.argv[1]))
parameters = ParameterSet(parameters=[])
with TemporaryDirectory() as folder:
    ZipFile(job["ssp"]).extractall(folder)
    for component in read_ssd(job["ssp"]).system.elements:
        for parameter in read_ssv(str(Path(folder) / f"resources/{component.name}.ssv")).parameters:
            parameter.name = f"{component.name}.{parameter.name}"
            parameter.value = float(parameter.value)
            parameters.parameters.append(parameter)
stop = (job["steps"] - 0.5) * job["step"]
result = simulate_ssp(job["ssp"], stop_time=stop, step_size=job["step"], parameter_set=parameters)
print(json.dumps([list(map(float, row)) for row in zip(*(result[name] for name in job["outputs"]), strict=True)]))
