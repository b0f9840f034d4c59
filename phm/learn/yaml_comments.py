"""Comments in a YAML tree of ruamel.yaml.

ruamel.yaml keeps a comment with the key or item before it: one token holds the comment at the end of that line and all comment
lines below it, up to the next key. So whatever is added or replaced must take over the comments that follow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ruamel.yaml.comments import CommentedBase, CommentedMap, CommentedSeq

_EOL = 2
"""Position of that token among the comments of a key; of an item it is 0."""


def add(entry: CommentedMap, key: str, text: str) -> None:
    """Set the comment at the end of the key's line, unless there is one. A mapping in braces gets one line per key."""
    if entry.fa.flow_style():
        entry.fa.set_block_style()
    token = _token(entry, key)
    if token is None:
        entry.yaml_add_eol_comment(text, key, column=0)
    elif not token.value.partition("\n")[0].strip():
        token.value = f"# {text}{token.value if token.value.startswith(chr(10)) else chr(10)}"
        token.column = 0


def remove(entry: CommentedMap, key: str, mark: str) -> None:
    """Remove the comment at the end of the key's line if it begins with `mark`."""
    token = _token(entry, key)
    if token is None:
        return
    first, _, rest = token.value.partition("\n")
    if first.lstrip("# ").startswith(mark):
        if rest.strip():
            token.value = f"\n{rest}"
        else:
            _set(entry, key, None)


def take_following(entries: Sequence[Any]) -> str:
    """Detach the comment lines behind the last entry that are about what follows: indented less than the entry."""
    if not entries:
        return ""
    last = entries[-1]
    holder, key = _last_leaf(last)
    token = _token(holder, key) if holder is not None else None
    if token is None:
        return ""
    column = last.lc.col if getattr(last, "lc", None) is not None and last.lc.col is not None else 0
    lines = token.value.split("\n")
    for number, line in enumerate(lines[1:], start=1):
        if line.strip() and len(line) - len(line.lstrip()) < column:
            start = number
            while start > 1 and not lines[start - 1].strip():
                start -= 1
            kept, taken = lines[:start], lines[start:]
            if any(part.strip() for part in kept):
                token.value = "\n".join(kept) + "\n"
            else:
                _set(holder, key, None)
            return "\n" + "\n".join(taken)
    return ""


def put_following(entries: Sequence[Any], text: str) -> None:
    """Attach what `take_following` returned behind the last entry."""
    if not text or not entries:
        return
    holder, key = _last_leaf(entries[-1])
    token = _token(holder, key)
    if token is not None:
        token.value = token.value.rstrip("\n") + text
    else:
        _set(holder, key, _new(text))


def replace_items(items: CommentedSeq, new: Sequence[Any]) -> None:
    """Replace the items of a list of scalars; the comments behind the last one stay behind the last one."""
    behind = _token(items, len(items) - 1)
    for place in range(len(items)):
        items.ca.items.pop(place, None)
    items[:] = list(new)
    if behind is not None and new:
        _set(items, len(items) - 1, behind)


def _last_leaf(node: Any) -> tuple[Any, Any]:
    """The collection and the key or index of the last scalar in it, in the order of the file."""
    holder, key = None, None
    while isinstance(node, (dict, list)) and node:
        style = getattr(node, "fa", None)
        if style is not None and style.flow_style():
            break  # its comments are with the key before it
        holder, key = node, list(node)[-1] if isinstance(node, dict) else len(node) - 1
        node = node[key]
    return holder, key


def _token(holder: CommentedBase, key: Any) -> Any:
    found = holder.ca.items.get(key)
    place = _EOL if isinstance(holder, dict) else 0
    return found[place] if found is not None and len(found) > place else None


def _set(holder: CommentedBase, key: Any, token: Any) -> None:
    found = holder.ca.items.setdefault(key, [None, None, None, None])
    found[_EOL if isinstance(holder, dict) else 0] = token
    if all(part is None for part in found):
        del holder.ca.items[key]


def _new(text: str) -> Any:
    from ruamel.yaml.error import CommentMark
    from ruamel.yaml.tokens import CommentToken

    return CommentToken(text, CommentMark(0), None)
