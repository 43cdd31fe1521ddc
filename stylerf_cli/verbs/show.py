"""`stylerf show PATH`: the contents of a work folder or an artifact."""

from pathlib import Path
from typing import Any

from schemas.canonical_json import plain
from schemas.errors import ArtifactDamaged, ArtifactStale
from schemas.scene import SCENE_FILE, read_scene
from schemas.work_folder import Artifact, WorkFolder
from stylerf_cli.arguments import Parser
from stylerf_cli.path_arguments import work_around, work_or_artifact
from stylerf_cli.progress import duration
from stylerf_cli.session import Session

CONFIG = None
NAMELESS = "nothing is written"
SHOWN_FILES = 12
SHOWN_ITEMS = 6


def add_arguments(parser: Parser) -> None:
    """PATH."""
    parser.add_argument("path", type=Path, metavar="PATH", help="a work folder or the folder of an artifact")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return an artifact's manifest with path, digest and reasons why it is stale, or a work folder's artifacts."""
    found = work_or_artifact(args.path)
    if isinstance(found, Artifact):
        result = described(found)
        return session.emit(result, _artifact_words(result))
    result = _work(found)
    return session.emit(result, _work_words(result))


def described(artifact: Artifact) -> dict[str, Any]:
    """Return the manifest as a dict with `path`, `digest`, `bytes` and `outdated` (reasons, empty if up to date)."""
    manifest: dict[str, Any] = plain(artifact.manifest)
    return (
        manifest
        | {
            "name": artifact.name,
            "path": artifact.path,
            "digest": artifact.digest,
            "bytes": sum(record["bytes"] for record in manifest["files"]),
            "outdated": work_around(artifact).outdated(artifact),
        }
        | _views(artifact)
    )


def _views(artifact: Artifact) -> dict[str, Any]:
    """Return the `views` of a scene: name, image, size and split."""
    if artifact.kind != "scene" or not artifact.has(SCENE_FILE):
        return {}
    kept = ("name", "image", "width", "height", "split")
    return {"views": [{key: getattr(view, key) for key in kept} for view in read_scene(artifact.path).views]}


def _work(work: WorkFolder) -> dict[str, Any]:
    rows = []
    for artifact in work.artifacts():
        row = {"kind": artifact.path.parent.name, "name": artifact.name}
        try:
            full = described(artifact)
            kept = ("stage", "digest", "created", "seconds", "peak_memory_mb", "bytes", "outdated")
            rows.append(row | {key: full[key] for key in kept} | {"fault": None})
        except (ArtifactDamaged, ArtifactStale) as error:
            rows.append(row | {"fault": str(error)})
    unfinished = [{"kind": kind, "name": name} for kind, name in work.unfinished()]
    return {"path": work.root, "artifacts": rows, "unfinished": unfinished}


def _work_words(result: dict[str, Any]) -> list[str]:
    lines = [f"work folder {result['path']}"]
    width = max([len(f"{row['kind']} {row['name']}") for row in result["artifacts"]], default=0)
    for row in result["artifacts"]:
        title = f"{row['kind']} {row['name']}".ljust(width)
        if row["fault"]:
            lines.append(f"  {title}  NOT READABLE: {row['fault']}")
            continue
        state = f"  OUT OF DATE: {row['outdated'][0]}" if row["outdated"] else ""
        lines.append(
            f"  {title}  {row['created'][:16].replace('T', ' ')}  {row['bytes'] / 1e6:8.1f} MB  "
            f"{duration(row['seconds']):>12}{state}"
        )
    for row in result["unfinished"]:
        lines.append(f"  {row['kind']} {row['name']}: interrupted; rerun its command to resume")
    return lines


def _artifact_words(result: dict[str, Any]) -> list[str]:
    lines = [
        f"{result['kind']} {result['name']} ({result['path']})",
        f"  made by    {result['stage']} revision {result['revision']} on {result['created']}, "
        f"seed {result['seed']}, {result['device']}",
        f"  took       {duration(result['seconds'])}, up to {result['peak_memory_mb']:.0f} MB of memory",
        f"  digest     {result['digest'][:16]}  schema {result['schema']}",
        "  versions   " + ", ".join(f"{name} {number}" for name, number in result["versions"].items()),
    ]
    for ref in result["inputs"]:
        lines.append(f"  from       {ref['kind']} {ref['name']} {ref['digest'][:16]} as {ref['role']}")
    lines += [f"  OUT OF DATE {reason}" for reason in result["outdated"]]
    lines += _table("options", result["config"]) + _table("figures", result["figures"])
    lines += _view_lines(result.get("views", []))
    files = result["files"]
    lines.append(f"  files      {len(files)}, {result['bytes'] / 1e6:.2f} MB")
    lines += [f"    {one['bytes']:>12,}  {one['path']}" for one in files[:SHOWN_FILES]]
    if len(files) > SHOWN_FILES:
        lines.append(f"    and {len(files) - SHOWN_FILES} more")
    return lines


def _view_lines(views: list[dict[str, Any]]) -> list[str]:
    if not views:
        return []
    width = max(len(view["name"]) for view in views)
    return ["  views"] + [
        f"    #{number:<4} {one['name']:<{width}}  {one['width']}x{one['height']}  {one['split']:<5}  {one['image']}"
        for number, one in enumerate(views)
    ]


def _table(title: str, values: dict[str, Any]) -> list[str]:
    if not values:
        return []
    width = max(len(key) for key in values)
    return [f"  {title}"] + [f"    {key:<{width}}  {_short(value)}" for key, value in values.items()]


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        more = f" ... ({len(value)} in all)" if len(value) > SHOWN_ITEMS else ""
        return "[" + ", ".join(_short(item) for item in value[:SHOWN_ITEMS]) + "]" + more
    if isinstance(value, dict):
        items = list(value.items())
        more = ", ..." if len(items) > SHOWN_ITEMS else ""
        return ", ".join(f"{key} {_short(item)}" for key, item in items[:SHOWN_ITEMS]) + more
    return str(value)
