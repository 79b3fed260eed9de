"""The server of the web page: HTTP and a websocket, between browsers and one board."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from aiohttp import WSMessage, WSMsgType, web

from ..boardfile import page_files
from ..run.tcp_link import why_not
from .access import Access
from .board_link import BoardLink, Source
from .hub import Browser, Hub
from .preview import PROGRAM_BYTES
from .preview_queue import LONGEST_S, PreviewQueue
from .shared_job import program_of

# JSON doubles escaped characters, and the request also holds the settings.
_BODY_BYTES = 2 * PROGRAM_BYTES + (1 << 20)
_MESSAGE_BYTES = 1 << 20
# A browser whose network has failed is detected after 1.5 times this interval.
_HEARTBEAT_S = 6.0
_GOODBYE_S = 1.0
_AWAY = 1001  # close code: the server ends

_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Server:
    """Serve one board.

    access: checks requests; board: name of the simulated board for previews; log: receives
    sentences for the user who runs the server.
    """

    def __init__(
        self,
        source: Source,
        access: Access,
        board: str,
        log: Callable[[str], None],
        page: Callable[[], str] = page_files.page,
        longest_s: float = LONGEST_S,
    ) -> None:
        self._access = access
        self._log = log
        self._page = page
        self._loop = asyncio.get_running_loop()
        self._link = BoardLink(source, self._heard, self._link_changed, self._log_from_thread)
        self._hub = Hub(self._link, log)
        self._previews = PreviewQueue(board, log, longest_s)
        self._sockets: set[web.WebSocketResponse] = set()
        self._runner: web.AppRunner | None = None

    async def start(self, host: str, port: int) -> int:
        """Listen and open the board. Return the port, which the system chooses for port 0.

        Raises OSError if the address cannot be used, SendError if the board cannot be opened.
        """
        app = web.Application(middlewares=[self._guard], client_max_size=_BODY_BYTES)
        app.router.add_get("/", self._get_page)
        app.router.add_get("/ws", self._get_socket)
        app.router.add_post("/api/look", self._post_look)
        app.router.add_get("/api/job", self._get_job)
        app.router.add_post("/api/job", self._post_job)
        app.router.add_route("*", "/{rest:.*}", _answer_404)
        app.on_shutdown.append(self._close_sockets)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=_GOODBYE_S)
        await self._runner.setup()
        try:
            await web.TCPSite(self._runner, host, port).start()
        except OSError as error:
            why = f"cannot listen at {host}:{port}: {why_not(error)} (--host and --http)"
            raise OSError(why) from error
        await self._loop.run_in_executor(None, self._link.start)
        self._hub.link_changed()  # a browser may have connected before the board was open
        return int(self._runner.addresses[0][1])

    async def stop(self) -> None:
        """Disconnect all browsers, then the board; a moving machine is held, a jog cancelled."""
        self._previews.close()
        if self._runner is not None:
            await self._runner.cleanup()
        await self._loop.run_in_executor(None, self._link.close)

    # From the board's threads

    def _heard(self, data: bytes) -> None:
        self._loop.call_soon_threadsafe(self._hub.heard, data)

    def _link_changed(self) -> None:
        self._loop.call_soon_threadsafe(self._hub.link_changed)

    def _log_from_thread(self, text: str) -> None:
        self._loop.call_soon_threadsafe(self._log, text)

    # Requests

    @web.middleware
    async def _guard(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        """Refuse a request that access does not accept, or that is too large."""
        refusal = self._access.refusal(request.headers, request.query)
        if refusal:
            return _sentence(403, refusal)
        try:
            return await handler(request)
        except web.HTTPRequestEntityTooLarge:
            return _sentence(413, f"a program may have at most {PROGRAM_BYTES >> 20} MB")

    async def _get_page(self, request: web.Request) -> web.StreamResponse:
        """Answer with the page, and with headers that restrict what it may load."""
        try:
            text = self._page()
        except FileNotFoundError as error:
            return _sentence(404, f"the page is missing, {error.filename}: install ugrbl anew")
        # A foreign page may not put ours in a frame and have its buttons clicked unseen.
        sources = f"default-src 'self' 'unsafe-inline' data: blob:; connect-src 'self' ws://{request.host}"
        return web.Response(
            text=text,
            content_type="text/html",
            headers={
                "Content-Security-Policy": f"{sources}; frame-ancestors 'none'",
                "Referrer-Policy": "no-referrer",  # the address may hold the token
                "Cache-Control": "no-cache",
            },
        )

    async def _post_look(self, request: web.Request) -> web.StreamResponse:
        """Answer with the preview of the posted program."""
        answer = await self._previews.look(await request.read())
        if answer.status != 200:
            return _sentence(answer.status, answer.text)
        return web.Response(text=answer.text, content_type="application/json")

    async def _get_job(self, request: web.Request) -> web.StreamResponse:
        """Answer with the open program."""
        return web.json_response(self._hub.get_program())

    async def _post_job(self, request: web.Request) -> web.StreamResponse:
        """Open the posted program for all browsers."""
        program = program_of(await request.read())
        if program is None:
            return _sentence(
                400, 'the request needs a program: {"id", "name", "program"}, each a text'
            )
        if not self._hub.open_job(program):
            return _sentence(409, "a job is under way: end it first")
        return web.json_response({})

    async def _get_socket(self, request: web.Request) -> web.StreamResponse:
        """Connect a browser to the board until its websocket ends."""
        socket = web.WebSocketResponse(
            heartbeat=_HEARTBEAT_S,
            max_msg_size=_MESSAGE_BYTES,
            compress=False,
            timeout=_GOODBYE_S,
        )
        if not socket.can_prepare(request).ok:
            return _sentence(400, "this address is for websockets: open / in a browser")
        await socket.prepare(request)

        def drop() -> None:
            """End the connection at once."""
            if request.transport is not None:
                request.transport.abort()

        browser = Browser(socket, f"browser {request.remote or ''}".strip(), drop)
        self._sockets.add(socket)
        sending = asyncio.create_task(_send_on(browser))
        self._hub.join(browser)
        try:
            await self._listen(socket, browser)
        finally:
            self._hub.leave(browser)
            self._sockets.discard(socket)
            sending.cancel()
        return socket

    async def _listen(self, socket: web.WebSocketResponse, browser: Browser) -> None:
        """Handle a browser's messages until the connection ends: JSON is for this server; binary
        ones, and other text, are bytes for the board."""
        async for message in socket:
            if message.type is WSMsgType.BINARY:
                await self._hub.send(browser, message.data)
            elif message.type is WSMsgType.TEXT and message.data.startswith("{"):
                await self._do_message(browser, message)
            elif message.type is WSMsgType.TEXT:  # Grbl senders send text messages
                await self._hub.send(browser, message.data.encode("latin-1", "ignore"))

    async def _do_message(self, browser: Browser, message: WSMessage) -> None:
        """Do what a JSON message says: {"drive": true or false} takes or releases control, {"job":
        progress, "lines": text} reports a job's progress and sends its lines."""
        try:
            fields = message.json()
        except ValueError:
            fields = {}
        if isinstance(fields.get("drive"), bool):
            self._hub.drive(browser, fields["drive"])
        elif isinstance(fields.get("job"), dict) and isinstance(fields.get("lines"), str):
            await self._hub.tell_job(browser, fields["job"], fields["lines"])
        else:
            self._log(f"{browser.who} sent a command that this server does not know; ignored")

    async def _close_sockets(self, app: web.Application) -> None:
        """Close all sockets at the same time, so that no slow one delays the others."""
        goodbyes = [socket.close(code=_AWAY) for socket in tuple(self._sockets)]
        await asyncio.gather(*goodbyes, return_exceptions=True)


async def _send_on(browser: Browser) -> None:
    """Send a browser's queued parts until its connection breaks."""
    with suppress(ConnectionError):  # the reading side detects it, too
        await browser.send_on()


async def _answer_404(request: web.Request) -> web.StreamResponse:
    """Answer for an unknown path."""
    return _sentence(404, f"there is no {request.path} here: the page is at /")


def _sentence(status: int, text: str) -> web.Response:
    """Return an answer of plain text, above all a refusal."""
    return web.Response(status=status, text=text + "\n")
