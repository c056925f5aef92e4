"""OPC UA read by another implementation: node-opcua, where Node.js and the package are there.

``npm install node-opcua-client`` in a folder, and its ``node_modules`` in NODE_PATH, brings it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.core.alarms import Alarm

pytest.importorskip("asyncua", reason="asyncua is not installed; pip install 'beltscape[opcua]' brings it")

from tests.protocols.opcua import PASSWORD, Running

NODE = shutil.which("node")


def has_client() -> bool:
    """Return whether Node.js finds node-opcua."""
    if NODE is None:
        return False
    asked = [NODE, "-e", "require.resolve('node-opcua-client')"]
    return subprocess.run(asked, capture_output=True, check=False, cwd=Path(__file__).parent).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not has_client(), reason="Node.js with node-opcua-client is not there (NODE_PATH)")
def test_node_opcua_browses_reads_subscribes_and_calls(tmp_path: Path) -> None:
    running = Running(tmp_path, clients="any")
    running.plant.add(50)
    assert NODE is not None
    script = Path(__file__).parent / "opcua_client.js"
    command = [NODE, str(script), running.address, str(tmp_path / "pki"), "otto", PASSWORD]
    result = ""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("READY"):
                running.plant.add(30)
                alarm = Alarm("overload", "critical", "raised", 600.0, 500.0, "", 1, line)
                state = running.plant.state
                running.plant.state = replace(state, wall_ns=state.wall_ns + 10**9, alarms=(alarm,))
            result = line
    running.server.close()
    found = json.loads(result.removeprefix("RESULT "))
    for mode, records in (("Sign", 50), ("SignAndEncrypt", 80)):
        one = found[mode]
        assert one["flow"][:2] == ["Good", 123.4]
        assert one["speed"][:2] == ["BadSensorFailure", None]
        assert one["unit"] == ["t/h", 0x453138]
        assert one["total"] == {"gross": 0, "net": 0, "tare": 0}
        assert one["history"] == list(range(1, records + 1))
        assert one["calls"] == ["Good", "BadInvalidState"]
        assert one["seen"] == list(range(records, records + 31))
        assert one["events"] == [[f"READY {mode}\n", 800, "overload", True, False, 16]]
    assert found["refused"] == ["wrong password", "anonymous"]
