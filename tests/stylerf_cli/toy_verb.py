"""A verb around the toy stage, for tests of the front door."""

import os
from dataclasses import dataclass

from stages.configs import option
from tests.stages import toy_stage


@dataclass(frozen=True)
class CONFIG:
    steps: int = option(5, help="how many steps")
    pause: float = option(0.0, help="seconds between steps")
    color: str = option("red", help="which one", choices=("red", "blue"))
    sizes: tuple[int, ...] = option((1, 2), help="sizes")
    bounce: bool = option(True, help="whether it bounces")

    def __post_init__(self):
        if self.steps < 0:
            raise ValueError(f"steps must not be negative, found {self.steps}")


FAULT: list[BaseException] = []


def add_arguments(parser) -> None:
    parser.add_argument("work")


def run(args, session) -> dict:
    if FAULT:
        raise FAULT.pop()
    given = {"name": session.name, "force": session.force}
    artifact = session.pipeline.run(toy_stage.SPEC, toy_stage.run, {}, session.config, "fox", **given)
    if session.json:
        print("noise from a library")
        os.write(1, b"noise from native code\n")
    return session.emit({"name": artifact.name, "seconds": float("inf")}, [f"made {artifact.name}"])
