"""The server's routes."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable
from pathlib import Path
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from skysweep.errors import UserError
from skysweep.mission.orders import Order
from skysweep.results.picture_files import told_by_name
from skysweep.results.run_folder import FILM, JOURNAL_FILE, PICTURES
from skysweep.web.entries import end_s, entries, report_of, thumbnail_of
from skysweep.web.feed import Feed, Place
from skysweep.web.ground import ground_picture
from skysweep.web.orders import checked_order
from skysweep.web.places import Places
from skysweep.web.scene import head_of, heights_of, scenario_of, scene_of
from skysweep.web.security import Access, Guard

STATIC = Path(__file__).parent / "static"  # the built front end
_PERIOD_S = 0.2  # between looks at a journal
_BEGINS_S = 120.0  # a mission of this process needs no longer to be prepared
_LONGEST_ORDER = 4096  # bytes
_MOST_ORDERS, _WITHIN_S = 20, 10.0  # of one word
_KEPT = 4  # feeds without a viewer
_REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
_PICTURE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox"

Give = Callable[[Order], None]
Answer = Callable[[Request], Awaitable[Response]]


class App:
    """Serves the runs in one folder.

    ``live`` is the id of the mission whose process started this server, and ``give`` passes orders to it.
    """

    def __init__(
        self, places: Places, access: Access, live: str | None = None, give: Give | None = None
    ) -> None:
        self._places, self._access, self._live, self._give = places, access, live, give
        self._feeds: dict[Path, Feed] = {}
        self._given_s: dict[str, deque[float]] = {}  # times of the newest orders, by word
        self._drawing = asyncio.Lock()

    def asgi(self) -> Starlette:
        """The application to serve."""
        run = "/api/runs/{id:path}"
        get = [
            ("/api/folder", self._folder),
            (f"{run}/scene", self._scene),
            (f"{run}/heights", self._heights),
            (f"{run}/ground.jpg", self._ground),
            (f"{run}/film/{{name}}", self._film),
            (f"{run}/pictures/{{name}}", self._picture),
            (f"{run}/report", self._report),
            (f"{run}/thumbnail", self._thumbnail),
        ]
        return Starlette(
            routes=[
                *(Route(path, _told(answer)) for path, answer in get),
                Route(f"{run}/operator", _told(self._order), methods=["POST"]),
                Route("/api/session", self._session, methods=["POST"]),
                WebSocketRoute(f"{run}/follow", self._follow),
                Route("/", self._page),
                Route("/run/{id:path}", self._page),
                Mount("/", StaticFiles(directory=STATIC, check_dir=False)),
            ],
            middleware=[Middleware(Guard, access=self._access)],
        )

    async def _page(self, _request: Request) -> Response:
        index = STATIC / "index.html"
        if not index.is_file():
            return Response("The page is not built: run  tools/web.sh", 503, media_type="text/plain")
        return FileResponse(index)

    async def _session(self, request: Request) -> Response:
        if not self._access.has_token(request):
            return _refused(401, "The token is not that of this server.")
        answer = JSONResponse({"controls": self._give is not None})
        answer.set_cookie(self._access.cookie, self._access.sight, httponly=True, samesite="strict")
        return answer

    async def _folder(self, _request: Request) -> Response:
        found = await run_in_threadpool(entries, self._places, self._live)
        return JSONResponse({"name": self._places.root.name, "live": self._live, "entries": found})

    async def _scene(self, request: Request) -> Response:
        folder = await self._begun(request)
        identity = request.path_params["id"]
        ended_s = end_s(folder / JOURNAL_FILE) if (folder / JOURNAL_FILE).is_file() else None
        scene = await run_in_threadpool(scene_of, folder, ended_s)
        address = f"/api/runs/{quote(identity)}"
        scene["live"] = identity == self._live and ended_s is None
        scene["controls"] = scene["live"] and self._give is not None
        scene["ground"] = {
            "picture": f"{address}/ground.jpg" if scene["simulated"] else None,
            "heights": f"{address}/heights",
            "tiles": self._access.tiles,
        }
        return JSONResponse(scene)

    async def _heights(self, request: Request) -> Response:
        scenario = await run_in_threadpool(scenario_of, await self._begun(request))
        return JSONResponse(await run_in_threadpool(heights_of, scenario))

    async def _ground(self, request: Request) -> Response:
        folder = await self._begun(request)
        scenario, head = scenario_of(folder), head_of(folder)
        async with self._drawing:
            picture = await run_in_threadpool(ground_picture, scenario, int(head.get("seed", 0)))
        return Response(picture, media_type="image/jpeg", headers={"cache-control": "private, no-cache"})

    async def _film(self, request: Request) -> Response:
        name = request.path_params["name"]
        if not name.endswith(".jpg"):
            raise UserError("There is no such picture.")
        return _kept(self._places.file(self._asked(request), FILM, name))

    async def _picture(self, request: Request) -> Response:
        path = self._places.file(self._asked(request), PICTURES, request.path_params["name"])
        if told_by_name(path) is None:
            raise UserError("There is no such picture.")
        return _kept(path)

    async def _report(self, request: Request) -> Response:
        folder = self._asked(request)
        path = report_of(folder)
        if path is None:
            raise UserError("There is no report yet.")
        shown = self._places.file(path.parent, path.name)
        return FileResponse(shown, headers={"content-security-policy": _REPORT_POLICY})

    async def _thumbnail(self, request: Request) -> Response:
        path = thumbnail_of(self._asked(request))
        if path is None:
            raise UserError("There is no picture of it.")
        shown = self._places.file(path.parent, path.name)
        return FileResponse(shown, headers={"content-security-policy": _PICTURE_POLICY})

    async def _order(self, request: Request) -> Response:
        if not self._access.has_token(request):
            return _refused(401, "Open the address that skysweep printed: it holds the token for orders.")
        folder = self._asked(request)
        if self._give is None or request.path_params["id"] != self._live:
            return _refused(
                409, "This mission is not flown by the process that shows it: no orders reach it."
            )
        if end_s(self._places.file(folder, JOURNAL_FILE)) is not None:
            return _refused(409, "The mission has ended.")
        try:
            body = await _body(request)
            order, said = checked_order(json.loads(body))
        except UserError as error:
            return _refused(422, str(error))
        except (ValueError, RecursionError):
            return _refused(422, "The order is not JSON.")
        if not self._is_in_time(order.word):
            return _refused(429, f"Too many orders to {order.word} at once; wait {_WITHIN_S:.0f} s.")
        self._give(order)
        return JSONResponse({"said": said}, 202)

    async def _follow(self, socket: WebSocket) -> None:
        await socket.accept()
        identity = socket.path_params["id"]
        try:
            folder = self._places.root if identity == self._live else self._places.folder(identity)
            feed = self._feed(folder)
            asked = socket.query_params
            place = Place(line=_line(asked.get("from", "0")), mission=asked.get("mission"))
        except UserError as error:
            await socket.send_json({"type": "status", "flying": False, "ended": False, "error": str(error)})
            await socket.close()
            return
        listens = asyncio.create_task(_until_closed(socket))
        try:
            while not listens.done():
                more = feed.refresh()
                messages = feed.news(place)
                for message in messages:
                    await socket.send_text(message)
                if messages or more:
                    await asyncio.sleep(0)
                elif not await run_in_threadpool(feed.cover):
                    await asyncio.wait([listens], timeout=_PERIOD_S)
        except WebSocketDisconnect:
            pass
        finally:
            listens.cancel()

    def _is_in_time(self, word: str) -> bool:
        """Whether one more order of this word may be given now: orders must not pile up before a mission.

        Each word is counted alone: a flood of looks leaves room for a hold.
        """
        now_s, given_s = time.monotonic(), self._given_s.setdefault(word, deque(maxlen=_MOST_ORDERS))
        if len(given_s) == _MOST_ORDERS and now_s - given_s[0] < _WITHIN_S:
            return False
        given_s.append(now_s)
        return True

    def _asked(self, request: Request) -> Path:
        return self._places.folder(request.path_params["id"])

    async def _begun(self, request: Request) -> Path:
        """The folder of a request; that of the mission of this process once its journal has begun."""
        until_s = time.monotonic() + (_BEGINS_S if request.path_params["id"] == self._live else 0.0)
        while True:
            try:
                folder = self._asked(request)
                if head_of(folder) or time.monotonic() > until_s:
                    return folder
            except UserError:
                if time.monotonic() > until_s:
                    raise
            await asyncio.sleep(_PERIOD_S)

    def _feed(self, folder: Path) -> Feed:
        if folder not in self._feeds:
            while len(self._feeds) >= _KEPT:
                self._feeds.pop(next(iter(self._feeds)))
            is_live = self._live is not None and folder == self._places.root
            self._feeds[folder] = Feed(folder, is_live)
        return self._feeds[folder]


def _told(answer: Answer) -> Answer:
    """Answers a user's error with its sentence, and one of the system with its reason."""

    async def told(request: Request) -> Response:
        try:
            return await answer(request)
        except UserError as error:
            return _refused(404, str(error))
        except OSError as error:
            return _refused(500, f"The folder cannot be read ({error.strerror}).")

    return told


def _refused(code: int, sentence: str) -> Response:
    return JSONResponse({"error": sentence}, code)


def _line(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise UserError("from: is no line of a journal; write 0 or more.")
    return int(text)


async def _body(request: Request) -> bytes:
    """The body of a request. Raises UserError if it is long."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > _LONGEST_ORDER:
            raise UserError("The order is too long.")
    return body


def _kept(path: Path) -> Response:
    """A picture, asked for again by each page: another mission's may have had the same address."""
    return FileResponse(path, headers={"cache-control": "private, no-cache"})


async def _until_closed(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
