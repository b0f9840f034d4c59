"""PyYAML's syntax errors as sentences for the user, at the line where the mistake is.

PyYAML reports where it could not continue. A quote or a bracket that is not closed begins before that.
"""

from __future__ import annotations

import re

import yaml

_FOUND = re.compile(r"but (?:found|got) '?([^']*)'?$")
_BRACKETS = (yaml.FlowSequenceStartToken, yaml.FlowMappingStartToken)
_BRACKETS_END = (yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken)
_BEGIN = (yaml.StreamStartToken, yaml.DocumentStartToken)
_INDENTED = ("<block mapping start>", "<block sequence start>")
_BEFORE_NAME = {"while scanning an alias": "*", "while scanning an anchor": "&"}
"""What PyYAML reads when a name does not follow the character, as in `*.log`."""
_NO_COLON = "a ':' is missing after a key, or the space after it: write 'key: value'; or check the indentation"


def explain(error: yaml.MarkedYAMLError, text: str) -> tuple[int, str]:
    """The line, counted from 1, and what is wrong there in plain words for common mistakes."""
    problem, context = str(error.problem or error.context or "syntax error"), str(error.context or "")
    mark = error.problem_mark or error.context_mark
    if mark is None:
        return 0, f"is not valid YAML: {problem}"
    line, begun = mark.line + 1, (error.context_mark or mark).line + 1
    if "'\\t'" in problem:
        return line, "tab used for indentation: use spaces"
    if "expected a single document" in context:
        return line, "a second document starts here: keep one, without '---' between"
    first = _first_key_without_colon(problem, mark, text)
    if first is not None:
        return first, _NO_COLON
    if "mapping values are not allowed" in problem:
        return line, "unexpected ':': check the indentation and the line before, put text with ': ' in quotes"
    if "could not find expected ':'" in problem:
        return begun, _NO_COLON
    if "found undefined alias" in problem:
        return line, f"{problem}: define it with '&' first, or put text that starts with '*' in quotes"
    if context in _BEFORE_NAME:
        return line, f"put text that starts with '{_BEFORE_NAME[context]}' in quotes"
    if "unknown escape character" in problem or "expected escape sequence" in problem:
        return line, rf"{problem.removeprefix('found ')}: use single quotes, or '\\' for one backslash"
    if "cannot start any token" in problem:
        return line, f"{problem}: put the text in quotes"
    if "quoted scalar" in context and "end of stream" in problem:
        return begun, "the quote that begins here is not closed"
    words = f" {context}" if context and error.problem else ""
    return _unexpected(problem, mark, begun, text) or (line, f"is not valid YAML{words}: {problem}")


def _unexpected(problem: str, mark: yaml.Mark, begun: int, text: str) -> tuple[int, str] | None:
    """For something that is not allowed at `mark`; begun: the line where the block around it begins."""
    line, match = mark.line + 1, _FOUND.search(problem)
    if match is None:
        return None
    found = match[1]
    before = _tokens_before(text, mark.index)
    bracket = _open_bracket(before)
    if bracket is not None:
        return _in_bracket(bracket, line)
    if found == "<scalar>":
        return _after_quote(before, line)
    if found == "-":
        return (
            line,
            f"check the indentation: an entry of a list is among the keys of the block that begins in line {begun}",
        )
    if found == "?":
        return line, f"check the indentation: a key is among the entries of the list that begins in line {begun}"
    if found in _INDENTED and "<document start>" in problem:
        return line, "check the indentation: all keys of the top level begin in the same column"
    if found in _INDENTED:
        return line, f"check the indentation: it does not fit that of the block that begins in line {begun}"
    if not found.startswith("<"):
        return line, f"unexpected '{found}': remove it, or put the text in quotes"
    return None


def _first_key_without_colon(problem: str, mark: yaml.Mark, text: str) -> int | None:
    """The line of the first key, if it has no ': '. It is then text, to PyYAML, and the next key is the mistake."""
    if not ("mapping values are not allowed" in problem or "but found '<block mapping start>'" in problem):
        return None
    before = [token for token in _tokens_before(text, mark.index) if not isinstance(token, _BEGIN)]
    if len(before) != 1 or not isinstance(before[0], yaml.ScalarToken) or not before[0].plain:
        return None
    line = before[0].start_mark.line
    return line + 1 if line < mark.line else None


def _in_bracket(bracket: yaml.Token, line: int) -> tuple[int, str]:
    first, last = ("[", "]") if isinstance(bracket, yaml.FlowSequenceStartToken) else ("{", "}")
    begun = bracket.start_mark.line + 1
    before = "" if begun == line else f" before line {line}"
    return begun, f"the '{first}' is not closed{before}: a '{last}' or a ',' is missing"


def _after_quote(before: list[yaml.Token], line: int) -> tuple[int, str]:
    """Text after a quoted one: often the quote that ended there was meant to begin, as an earlier one was not closed."""
    quoted = before[-1] if before else None
    begun = quoted.start_mark.line + 1 if quoted is not None else line
    if begun < line:
        return begun, f"the quote that begins here ends in line {line}: close it before the end of this line"
    return line, "text follows a text in quotes: put all of it in quotes"


def _tokens_before(text: str, index: int) -> list[yaml.Token]:
    """What YAML is made of, up to a position."""
    found: list[yaml.Token] = []
    try:
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            if token.start_mark.index >= index:
                break
            found.append(token)
    except (yaml.YAMLError, ValueError, OverflowError):  # what is before the error is enough
        pass
    return found


def _open_bracket(tokens: list[yaml.Token]) -> yaml.Token | None:
    """The innermost one that is not closed."""
    opened: list[yaml.Token] = []
    for token in tokens:
        if isinstance(token, _BRACKETS):
            opened.append(token)
        elif isinstance(token, _BRACKETS_END) and opened:
            opened.pop()
    return opened[-1] if opened else None
