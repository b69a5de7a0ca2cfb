"""What the controls share: a wish is passed on in a thread, and what came of it is shown."""

import asyncio
from collections.abc import Callable

from nicegui import ui

from ehls_ros.dashboard.graph import Answer


async def ask(wish: Callable[[], Answer]) -> Answer:
    """Pass a wish on to the graph without holding the page up, and show the answer for a while."""
    answer = await asyncio.to_thread(wish)
    show(answer)
    return answer


def show(answer: Answer) -> None:
    """Show an answer for a while."""
    if answer.message:
        ui.notify(answer.message, type="positive" if answer.done else "negative", position="bottom-right", timeout=5000)


def button(text: str, wish: Callable[[], Answer], look: str) -> ui.button:
    """Make a button for a wish.

    Args:
        text: what stands on it.
        wish: passed on when it is pressed.
        look: properties of Quasar's button.
    """

    async def pressed() -> None:
        await ask(wish)

    return ui.button(text, on_click=pressed).props(f'{look} data-name="{text.lower()}"')
