"""`stylerf verify PATH`: re-hash every file of an artifact, or of all artifacts of a work folder."""

from pathlib import Path
from typing import Any

from schemas.errors import ArtifactDamaged, ArtifactStale
from schemas.work_folder import Artifact
from stylerf_cli.arguments import Parser
from stylerf_cli.path_arguments import work_or_artifact
from stylerf_cli.session import Session

CONFIG = None
NAMELESS = "nothing is written"


def add_arguments(parser: Parser) -> None:
    """PATH."""
    parser.add_argument("path", type=Path, metavar="PATH", help="a work folder or the folder of an artifact")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return {"sound": n, "damaged": 0, "artifacts": [{kind, name, sound, files, bytes, fault}]}.

    Raises:
        ArtifactDamaged: an artifact is damaged.
    """
    found = work_or_artifact(args.path)
    artifacts = [found] if isinstance(found, Artifact) else found.artifacts()
    session.progress.start("verify", len(artifacts), "artifact")
    rows = []
    for number, artifact in enumerate(artifacts):
        rows.append(_checked(artifact))
        session.progress.update(number + 1)
    session.progress.finish()
    faults = [row["fault"] for row in rows if not row["sound"]]
    result = {"sound": len(rows) - len(faults), "damaged": len(faults), "artifacts": rows}
    if faults:
        for fault in faults[1:]:
            session.say(fault)
        counted = f" ({len(faults)} of {len(rows)} artifacts are damaged)" if len(rows) > 1 else ""
        raise ArtifactDamaged(faults[0] + counted, result)
    return session.emit(result, [_words(row) for row in rows] or ["nothing to verify"])


def _checked(artifact: Artifact) -> dict[str, Any]:
    # Take the kind from the folder: the manifest may be damaged.
    row = {"kind": artifact.path.parent.name, "name": artifact.name, "path": artifact.path}
    try:
        artifact.verify()
    except (ArtifactDamaged, ArtifactStale) as error:
        return row | {"sound": False, "files": None, "bytes": None, "fault": str(error)}
    records = artifact.manifest.files
    return row | {"sound": True, "files": len(records), "bytes": sum(one.bytes for one in records), "fault": None}


def _words(row: dict[str, Any]) -> str:
    return f"{row['kind']} {row['name']}: sound, {row['files']} files, {row['bytes'] / 1e6:.1f} MB"
