"""Helpers of the controls: send a request to the graph from a thread and show the answer."""

import asyncio
from collections.abc import Callable

from nicegui import ui

from ehls_ros.dashboard.access import DOCUMENTS
from ehls_ros.dashboard.graph import Answer


async def ask(request: Callable[[], Answer]) -> Answer:
    """Send a request to the graph without blocking the page, and show the answer for a while."""
    answer = await asyncio.to_thread(request)
    show(answer)
    return answer


def show(answer: Answer) -> None:
    """Show an answer for a while."""
    if answer.message:
        ui.notify(answer.message, type="positive" if answer.done else "negative", position="bottom-right", timeout=5000)


def button(text: str, request: Callable[[], Answer], look: str) -> ui.button:
    """Make a button that sends a request.

    Args:
        text: its label.
        request: sent when the button is pressed.
        look: Quasar properties of the button.
    """

    async def pressed() -> None:
        await ask(request)

    return ui.button(text, on_click=pressed).props(f'{look} data-name="{text.lower()}"')


def document_link(name: str, title: str) -> str:
    """Return a link to a document as HTML; the browser adds the token, which is in the page's address alone.

    Args:
        name: of the document.
        title: text of the link.
    """
    address = f'href="{DOCUMENTS}{name}" onclick="this.search = location.search" target="_blank" rel="noopener"'
    return f'<a {address} data-name="document-{name}">{title}</a>'
