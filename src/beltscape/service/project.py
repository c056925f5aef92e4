"""Reading of project.toml with the operator's page, and replay of a capture in place of the cameras."""

from __future__ import annotations

from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.pipeline.live.project import (
    CaptureSettings,
    Project,
    RunSettings,
    read_alarm_texts,
    read_project,
)
from beltscape.protocols.settings import (
    ModbusSettings,
    MqttSettings,
    OpcUaSettings,
    OutputSettings,
    SyslogSettings,
)
from beltscape.service.settings import WebSettings, require_language
from beltscape.sources.encoder.settings import EncoderSettings


class ProjectSettings(RunSettings):
    """All settings of project.toml."""

    web: WebSettings = WebSettings()
    """The operator's page: the table [web]."""
    mqtt: MqttSettings | None = None
    """Records, state and alarms to a broker: the table [mqtt]."""
    modbus: ModbusSettings | None = None
    """State and totals as registers: the table [modbus]."""
    opcua: OpcUaSettings | None = None
    """State, totals, alarms and history as a server: the table [opcua]."""
    syslog: SyslogSettings | None = None
    """Changes of alarms to a syslog server: the table [syslog]."""
    outputs: OutputSettings | None = None
    """Pulses and currents of an I/O module: the table [outputs]."""


def open_project(path: Path) -> Project[ProjectSettings]:
    """Read and validate project.toml; InputError with one line that names the key, its value and the fix."""
    project = read_project(path, ProjectSettings)
    _require_languages(project)
    web = project.settings.web
    files = {key: getattr(web, key) for key in ("tls_certificate", "tls_key")}
    paths = {key: file and project.resolve(file) for key, file in files.items()}
    settings = project.settings.model_copy(update={"web": web.model_copy(update=paths)})
    settings = settings.model_copy(update=_resolve_production(project))
    if settings.mqtt is not None:
        settings = settings.model_copy(update={"mqtt": _resolve_mqtt(project, settings.mqtt)})
    if (opcua := settings.opcua) is not None:
        keys = ("certificate", "key")
        own = {key: project.resolve(file) for key in keys if (file := getattr(opcua, key))}
        settings = settings.model_copy(update={"opcua": opcua.model_copy(update=own)})
    if (syslog := settings.syslog) is not None:
        keys = ("tls_ca", "tls_certificate", "tls_key")
        own = {key: project.resolve(file) for key in keys if (file := getattr(syslog, key))}
        settings = settings.model_copy(update={"syslog": syslog.model_copy(update=own)})
    return Project(project.path, settings)


def _require_languages(project: Project[ProjectSettings]) -> None:
    """Raise InputError where the plant's own texts of alarms are in a language that the page does not have."""
    for code in read_alarm_texts(project).by_language:
        try:
            require_language(code)
        except ValueError as error:
            raise InputError(
                f"{project.resolve(project.settings.alarms.texts or Path())}: {error}"
            ) from error


def _resolve_production(project: Project[ProjectSettings]) -> dict[str, object]:
    """Return the tables of scale and reports with paths relative to the project's folder made absolute."""
    scale, reports = project.settings.scale, project.settings.reports
    if scale is not None and scale.csv is not None:
        scale = scale.model_copy(update={"csv": project.resolve(scale.csv)})
    if reports is not None and reports.mail is not None:
        mail = reports.mail
        files = {key: getattr(mail, key) for key in ("password_file", "tls_ca")}
        paths = {key: file and project.resolve(file) for key, file in files.items()}
        reports = reports.model_copy(update={"mail": mail.model_copy(update=paths)})
    return {"scale": scale, "reports": reports}


def _resolve_mqtt(project: Project[ProjectSettings], mqtt: MqttSettings) -> MqttSettings:
    """Return the settings with paths relative to the project's folder made absolute."""
    keys = ("password_file", "tls_ca", "tls_certificate", "tls_key")
    files = {key: getattr(mqtt, key) for key in keys}
    return mqtt.model_copy(update={key: file and project.resolve(file) for key, file in files.items()})


def substitute_capture(project: Project[ProjectSettings], capture: Path | None) -> Project[ProjectSettings]:
    """Return the project with a recorded capture in place of its cameras, played once.

    ``capture`` defaults to the project's own. Positions come from the capture's encoder.csv if the project has an
    encoder and the capture has that table.

    Raises
    ------
    InputError
        If neither names a capture.
    """
    settings = project.settings
    own = settings.capture
    if capture is None and own is None:
        raise InputError(f"{project.path}: has no [capture]; name one with --capture")
    folder = project.resolve(own.folder) if capture is None and own is not None else capture
    rate = None if own is None else own.frames_per_s
    replayed = CaptureSettings(folder=(folder or Path()).resolve(), frames_per_s=rate, loop=False)
    update: dict[str, object] = {"cameras": None, "capture": replayed}
    if settings.encoder.kind in ("file", "udp", "camera") and (replayed.folder / "encoder.csv").is_file():
        update["encoder"] = EncoderSettings(kind="capture")
    return Project(project.path, settings.model_copy(update=update))
