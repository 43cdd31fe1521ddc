"""`stylerf verify PATH`: re-hashes every file of an artefact, or of all artefacts of a work folder."""

from pathlib import Path

from schemas.errors import ArtefactDamaged, ArtefactStale
from schemas.work_folder import Artefact
from stylerf_cli.path_arguments import work_or_artefact

NAME = "verify"
HELP = "check every file of an artefact or a work folder against its digest"
CONFIG = None
NAMELESS = "nothing is written"


class NotSound(ArtefactDamaged):
    """Some artefact is damaged; `details` lists what was found of each, for --json."""

    def __init__(self, line: str, details: dict) -> None:
        super().__init__(line)
        self.details = details


def add_arguments(parser) -> None:
    """PATH."""
    parser.add_argument("path", type=Path, metavar="PATH", help="a work folder or the folder of an artefact")


def run(args, session) -> dict:
    """{"sound": n, "damaged": 0, "artefacts": [{kind, name, sound, files, bytes, fault}]}; NotSound when one is not."""
    found = work_or_artefact(args.path)
    artefacts = [found] if isinstance(found, Artefact) else found.artefacts()
    session.progress.start("verify", len(artefacts), "artefact")
    rows = []
    for number, artefact in enumerate(artefacts):
        rows.append(_checked(artefact))
        session.progress.update(number + 1)
    session.progress.finish()
    faults = [row["fault"] for row in rows if not row["sound"]]
    result = {"sound": len(rows) - len(faults), "damaged": len(faults), "artefacts": rows}
    if faults:
        for fault in faults[1:]:
            session.say(fault)
        counted = f" ({len(faults)} of {len(rows)} artefacts are not sound)" if len(rows) > 1 else ""
        raise NotSound(faults[0] + counted, result)
    return session.emit(result, [_words(row) for row in rows] or ["nothing to verify"])


def _checked(artefact: Artefact) -> dict:
    # The folder's place tells the kind even where the manifest no longer does.
    row = {"kind": artefact.path.parent.name, "name": artefact.name, "path": artefact.path}
    try:
        artefact.verify()
    except (ArtefactDamaged, ArtefactStale) as error:
        return row | {"sound": False, "files": None, "bytes": None, "fault": str(error)}
    records = artefact.manifest.files
    return row | {"sound": True, "files": len(records), "bytes": sum(one.bytes for one in records), "fault": None}


def _words(row: dict) -> str:
    return f"{row['kind']} {row['name']}: sound, {row['files']} files, {row['bytes'] / 1e6:.1f} MB"
