"""Options of `stylerf view`."""

from dataclasses import dataclass

from stages.configs import advanced, option

HERE = ("127.0.0.1", "localhost", "::1")  # hosts that only this machine reaches


@dataclass(frozen=True)
class ViewConfig:
    """Where the viewer is served, and how large its pictures are."""

    host: str = option("127.0.0.1", help="address to serve on; any but the local machine's adds a token to the URL")
    port: int = option(8080, help="port to serve on (0: any free one)")
    open: bool = option(True, help="open the page in this machine's browser")
    size: int = option(0, metavar="PIXELS", help="longer side of still pictures (0: as the scene's views)")
    fps: float = advanced(12.0, help="target frame rate while the camera moves, which sets their size")

    def __post_init__(self) -> None:
        if not self.host or not 0 <= self.port <= 65535:
            raise ValueError("host must not be empty, port 0 to 65535")
        if self.size and not 16 <= self.size <= 8192:
            raise ValueError("size must be 16 to 8192, or 0")
        if not 1 <= self.fps <= 60:
            raise ValueError("fps must be 1 to 60")
