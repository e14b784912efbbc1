"""FMUs built for tests: the held sink's equations in Python (co-simulation) and in C (model exchange)."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import textwrap
import zipfile
from collections.abc import Mapping
from pathlib import Path

import yaml

from twinmatch.fmu import worker
from twinmatch.launching.forking import Forked

PARAMETERS = {
    "seebeck": 0.075,
    "resistance": 3.3,
    "conductance": 0.35,
    "heat_capacity": 15.0,
    "ambient": 296.0,
    "supply": 12.0,
    "bridge_resistance": 0.1,
    "current_limit": 5.0,
}

RATE = """
def rate(self, plate):
    bridge = self.supply * self.pwm / 255.0
    loop = self.resistance + self.bridge_resistance
    wanted = (-bridge - self.seebeck * (self.ambient - plate)) / loop
    current = min(max(wanted, -self.current_limit), self.current_limit)
    joule = current**2 * self.resistance / 2
    drawn = self.seebeck * plate * current - joule + self.conductance * (plate - self.ambient)
    return -drawn / self.heat_capacity
"""

_SLAVE = """
import os, signal, time
from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real


class {name}(Fmi2Slave):
    author = "tests"
    description = "A Peltier plate on a sink that stays at one temperature"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.pwm = 0.0
        self.plate = 298.15
        self.inner = 0.0
        for name, value in {parameters!r}.items():
            setattr(self, name, value)
            self.register_variable(
                Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
            )
        self.register_variable(Real("pwm", causality=Fmi2Causality.input))
        self.register_variable(
            Real("plate", causality=Fmi2Causality.local, initial=Fmi2Initial.exact,
                 variability=Fmi2Variability.continuous)
        )
        self.register_variable(
            Real("celsius", causality=Fmi2Causality.output, getter=lambda: {output})
        )

{rate}

    def do_step(self, time_now, size):
        {culprit}
        h = size / {steps}
        for _ in range({steps}):
            x = self.plate
            k1 = self.rate(x)
            k2 = self.rate(x + 0.5 * h * k1)
            k3 = self.rate(x + 0.5 * h * k2)
            k4 = self.rate(x + h * k3)
            self.plate = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        {after}
        return True
"""

CULPRITS = {
    "": "pass",
    "hangs": "if time_now > 400: time.sleep(3600)",
    "spins": "while time_now > 400: pass",
    "crashes": "if time_now > 400: os.kill(os.getpid(), signal.SIGSEGV)",
    "ends": "if time_now > 400: os._exit(3)",
    "says nothing": "if time_now > 400: self.plate = float('nan')",
    "refuses": "if time_now > 400: return False",
    "eats": "self.hoard = bytearray(1 << 33) if time_now > 400 else b''",
    "leaves a program": "import subprocess; self.left = subprocess.Popen("
    "['sleep', '600.125'], start_new_session=True) if time_now > 400 else 0",
    "prints": "print('what an FMU prints is not an answer'); os.write(1, b'garbage' * 100)",
}
"""What an FMU may do wrong late in a run, after all that is tried when it is adopted."""


def python_slave(
    name: str = "Plate",
    *,
    culprit: str = "",
    rate: str = RATE,
    output: str = "self.plate - 273.15",
    after: str = "pass",
    steps: int = 40,
) -> str:
    """The source of a slave for pythonfmu."""
    return textwrap.dedent(_SLAVE).format(
        name=name,
        parameters=PARAMETERS,
        rate=textwrap.indent(textwrap.dedent(rate).strip(), "    "),
        output=output,
        culprit=CULPRITS[culprit],
        after=after,
        steps=steps,
    )


def build_python_fmu(folder: Path, name: str = "Plate", **how: object) -> Path:
    """A co-simulation FMU (FMI 2) whose slave is Python."""
    from pythonfmu.builder import FmuBuilder

    source = folder / f"{name.lower()}.py"
    source.write_text(python_slave(name, **how), encoding="utf-8")  # type: ignore[arg-type]
    return Path(FmuBuilder.build_FMU(str(source), dest=str(folder)))


def write_map(
    folder: Path, fmu: Path, name: str = "the shop's", **changes: object
) -> Path:
    """A file that makes an FMU of the plate a structure of the Peltier rig."""
    entry: dict[str, object] = {
        "fmu": str(fmu),
        "variables": {
            "temperature": "celsius",
            "pwm": "pwm",
            "plate": "plate",
            **{parameter: parameter for parameter in PARAMETERS},
        },
        "starts": {"plate": "temperature + 273.15"},
        "free": ["seebeck", "conductance", "heat_capacity"],
    }
    entry.update(changes)
    file = folder / f"{fmu.stem}.yaml"
    tree = {"plant": "peltier", "structures": {name: entry}}
    file.write_text(yaml.safe_dump(tree, allow_unicode=True), encoding="utf-8")
    return file


class ForkedWorker(Forked):
    """The program of an FMU's process, forked from this one: its start is nearly all imports."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        """As `twinmatch.fmu.process.started`, but its environment also holds what this process began with."""
        asked, ask = os.pipe()
        answers, answer = os.pipe()
        process = os.fork()
        if process == 0:
            try:
                os.setsid()
                for place, end in enumerate(
                    (asked, answer, os.open(os.devnull, os.O_WRONLY))
                ):
                    os.dup2(end, place)
                os.closerange(3, os.sysconf("SC_OPEN_MAX"))
                sys.stdout, sys.stderr = (
                    os.fdopen(place, "w", closefd=False) for place in (1, 2)
                )
                for number in (signal.SIGALRM, signal.SIGINT, signal.SIGTERM):
                    signal.signal(number, signal.SIG_DFL)
                os.environ.clear()
                os.environ.update(environment)
                os.chdir(folder)
                worker.main()
            finally:
                os._exit(1)
        os.close(asked)
        os.close(answer)
        super().__init__(["twinmatch.fmu.worker"], process)
        self.stdin = os.fdopen(ask, "wb")
        self.stdout = os.fdopen(answers, "rb")


_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="plate" guid="{{held-sink}}"
  numberOfEventIndicators="{indicators}">
  <ModelExchange modelIdentifier="plate"/>
  <ModelVariables>
{variables}
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="{output}"/></Outputs>
    <Derivatives><Unknown index="{derivative}"/></Derivatives>
  </ModelStructure>
</fmiModelDescription>
"""

_XML_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="plate" instantiationToken="{{held-sink}}">
  <ModelExchange modelIdentifier="plate"/>
  <CoSimulation modelIdentifier="plate" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>
{variables}
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="3"/>
    <ContinuousStateDerivative valueReference="2"/>
  </ModelStructure>
</fmiModelDescription>
"""


def build_c_fmu(
    folder: Path, *, events: bool = False, joule: bool = True, cut_out: bool = False
) -> Path:
    """A model-exchange FMU (FMI 2) of the same equations, compiled.

    The current limit may be an event, Joule's heat may have been forgotten, and a cut-out with hysteresis, of
    which its description says nothing, may switch it off.
    """
    import fmpy.fmi2

    code = _source("plate.c")
    if cut_out:
        code = code.replace("double pwm, plate;", "double pwm, plate, off;").replace(
            "m->pwm = 0;", "m->pwm = m->off = 0;"
        )
        code = code.replace(
            "double most =",
            "m->off = m->plate > 335 || (m->off && m->plate > 325); double most =",
        )
        code = code.replace("m->pwm / 255.0", "m->pwm * (1 - m->off) / 255.0")
    if not joule:
        code = code.replace("- current * current * m->p[resistance] / 2", "")
    lines = [
        f'    <ScalarVariable name="{name}" valueReference="{k}" {kind}><Real {real}/></ScalarVariable>'
        for k, (name, kind, real) in enumerate(_variables())
    ]
    xml = _XML.format(
        variables="\n".join(lines),
        output=4,
        derivative=3,
        indicators=2 if events else 0,
    )
    return _compiled(folder, code, _left_out(code, fmpy.fmi2.FMU2Model), xml, "linux64")


def build_c_fmu_3(folder: Path) -> Path:
    """An FMU of FMI 3 of the same equations, for model exchange and co-simulation."""
    import fmpy.fmi3

    code = _source("plate3.c")
    lines = [
        f'    <Float64 name="{name}" valueReference="{k}" {kind} {real}/>'
        for k, (name, kind, real) in enumerate(_variables())
    ]
    xml = _XML_3.format(
        variables="\n".join(lines).replace('derivative="2"', 'derivative="1"')
    )
    stubs = _left_out(code, fmpy.fmi3.FMU3Model, fmpy.fmi3.FMU3Slave)
    return _compiled(folder, code, stubs, xml, "x86_64-linux")


def _source(name: str) -> str:
    code = (Path(__file__).parent / name).read_text(encoding="utf-8")
    values = ", ".join(map(str, PARAMETERS.values()))
    return code.replace("@values@", values).replace("@names@", ", ".join(PARAMETERS))


def _variables() -> list[tuple[str, str, str]]:
    return [
        ("pwm", 'causality="input"', 'start="0"'),
        (
            "plate",
            'causality="local" variability="continuous" initial="exact"',
            'start="298.15"',
        ),
        ("der(plate)", 'causality="local" variability="continuous"', 'derivative="2"'),
        ("celsius", 'causality="output" variability="continuous"', ""),
        *(
            (n, 'causality="parameter" variability="fixed"', f'start="{v}"')
            for n, v in PARAMETERS.items()
        ),
    ]


def _compiled(folder: Path, code: str, stubs: str, xml: str, platform: str) -> Path:
    """The FMU of some sources and a description."""
    import fmpy

    build = folder / "build"
    build.mkdir(parents=True)
    for name, text in (("plate.c", code), ("others.c", stubs)):
        (build / name).write_text(text, encoding="utf-8")
    headers = Path(fmpy.__file__).parent / "c-code"
    subprocess.run(
        [
            "gcc",
            "-shared",
            "-fPIC",
            "-O2",
            "-w",
            f"-I{headers}",
            "plate.c",
            "others.c",
            "-o",
            "plate.so",
        ],
        cwd=build,
        check=True,
    )
    file = folder / "plate.fmu"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", xml)
        archive.write(build / "plate.so", f"binaries/{platform}/plate.so")
    shutil.rmtree(build)
    return file


def _left_out(code: str, *bases: type) -> str:
    """Functions that FMPy wants to find, and that say that they cannot do it."""
    names = {
        name
        for base in bases
        for name in dir(base)
        if name.startswith(("fmi2", "fmi3"))
    }
    return "".join(
        f"int {name}(void) {{ return 3; }}\n"
        for name in sorted(names)
        if f"{name}(" not in code
    )
