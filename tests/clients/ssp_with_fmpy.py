"""Runs an SSP in FMPy: ``ssp_with_fmpy.py JOB.json`` prints the outputs after each step as JSON.

FMPy leaves parameter sets to its caller: they are read here, and named as it wants them, COMPONENT.PARAMETER.
"""

import json
import sys
import zipfile
from types import SimpleNamespace
from xml.etree import ElementTree

from answer import answer
from fmpy.ssp.simulation import simulate_ssp

SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"

job = json.load(open(sys.argv[1]))
parameters = []
with zipfile.ZipFile(job["ssp"]) as archive:
    system = ElementTree.fromstring(archive.read("SystemStructure.ssd"))
    for component in system.iter(f"{SSD}Component"):
        for binding in component.iter(f"{SSD}ParameterBinding"):
            values = ElementTree.fromstring(archive.read(binding.get("source")))
            for parameter in values.iter(f"{SSV}Parameter"):
                name = f"{component.get('name')}.{parameter.get('name')}"
                parameters.append(SimpleNamespace(name=name, value=parameter[0].get("value")))
n, h = job["steps"], job["step"]
result = simulate_ssp(
    job["ssp"], stop_time=(n - 0.5) * h, step_size=h, parameter_set=SimpleNamespace(parameters=parameters)
)
print(json.dumps([[float(row[name]) for name in job["outputs"]] for row in result]), file=answer, flush=True)
