"""Look at node classes, in the process that may import them, and say what they declare as plain data.

The launcher never imports a workspace's modules: a child runs :func:`inspect_classes` and sends back its
answer. What is wrong with a module is part of that, with the line of its source, and never an exception.
"""

import contextlib
import importlib
import importlib.util
import pkgutil
import sys
import traceback
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import msgspec

from palp_core.errors import BagError, GraphError, in_words
from palp_core.extras import advice
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import MessageType
from palp_core.graph.node.loading import enter_workspace, load_module
from palp_core.graph.node.node import Declaration, Node, declaration_of
from palp_core.graph.node.params import ParamDescription, describe_params, load_params
from palp_core.graph.node.ports import Port, PortKind, Pub, Sub
from palp_core.graph.problems import hint, nearest
from palp_core.graph.workspaces.underlays import underlays
from palp_core.whole_file import check_regular

LARGEST_MODULE_BYTES = 16 << 20
_LIBRARY = Path(__file__).resolve().parents[2]


class NodeClassRequest(msgspec.Struct, frozen=True):
    """Ask what a node class declares and whether parameters fit it.

    Attributes:
        name: Under which the node runs; some classes' ports depend on it and on the parameters.
        offered: Those of the parameters that count only if the class declares them.
    """

    run: str
    params: dict[str, Any] = {}
    kind: Literal["node", "function"] = "node"
    name: str = ""
    offered: tuple[str, ...] = ()


class NodePort(msgspec.Struct, frozen=True):
    """A port.

    Attributes:
        types: Its message; of a service and a client, request and reply; of an action and a client of one,
            goal, feedback and result. What these are made of is there as ports, too.
        qos: What it offers or requests; that of a service is the default.
        lasting: An input, optional as long as it is not wired.
        vacant: An output that the class does not have: optional inputs of others are wired to it.
    """

    name: str
    kind: PortKind
    types: list[MessageType]
    qos: Qos
    optional: bool = False
    lasting: bool = False
    vacant: bool = False


class Successors(msgspec.Struct, frozen=True):
    """Classes that are to take a node's place, one after the other."""

    node: str
    runs: list[str]


class NodeClass(msgspec.Struct, frozen=True, kw_only=True):
    """What a node class declares.

    Attributes:
        error: Why there is nothing more to say; None when all is well.
        param_errors: What is wrong with the parameters tried, by name; "" for all of them together.
        successors: What parameters name to take a node's place later, by parameter. A parameter says so by
            ``Annotated[str, Meta(extra={"successors": (node, function)})]``, whose function returns the
            classes of a value, in their order.
        same_params: By input, parameters that must be as those of the node that is wired to it.
        examined: Each fits by itself, and the class has something against them all the same.
    """

    run: str
    error: str | None = None
    doc: str = ""
    ports: dict[str, NodePort] = {}
    params: dict[str, ParamDescription] = {}
    param_errors: dict[str, str] = {}
    successors: dict[str, Successors] = {}
    examined: bool = False
    moves: bool = False
    simulates: bool = False
    records: bool = False
    on_probation: bool = False
    same_params: dict[str, tuple[str, ...]] = {}


def inspect_classes(requests: Sequence[NodeClassRequest], workspace: Path) -> list[NodeClass]:
    """Describe node classes; what modules print while they are imported goes to standard error."""
    return list(inspected(requests, workspace))


def inspected(requests: Sequence[NodeClassRequest], workspace: Path) -> Iterator[NodeClass]:
    """Yield what :func:`inspect_classes` returns, one by one: a module may end the process."""
    enter_workspace(str(workspace))
    for request in requests:
        with contextlib.redirect_stdout(sys.stderr):
            answer = _inspect(request, workspace)
        yield answer


class _Refusal(Exception):
    """There is nothing to describe; its text says why."""


def _inspect(request: NodeClassRequest, workspace: Path) -> NodeClass:
    module_name, _, name = request.run.rpartition(":")
    try:
        module = _module(module_name, workspace)
        if request.kind == "function":
            _function(module, module_name, name)
            return NodeClass(run=request.run)
        return _node(_class(module, module_name, name).shaped(request.name, request.params), request)
    except (_Refusal, BagError) as refusal:
        return NodeClass(run=request.run, error=str(refusal))
    except BaseException as error:  # noqa: BLE001 - a workspace's module may raise anything
        return NodeClass(run=request.run, error=_located(error, workspace))


def _node(cls: type[Node], request: NodeClassRequest) -> NodeClass:
    declared = declaration_of(cls)
    known = describe_params(declared.params)
    given = {
        key: value for key, value in request.params.items() if key in known or key not in request.offered
    }
    errors = param_errors(declared, given)
    if examined := not errors:
        errors = cls.examine(load_params(declared, given, declared.params.__name__))
    return NodeClass(
        run=request.run,
        doc=(cls.__doc__ or "").strip().partition("\n")[0],
        ports={port.name: _port(port) for port in declared.wired},
        params=known,
        param_errors=errors,
        successors=_successors_named(declared.params, given) if not errors else {},
        examined=examined,
        moves=cls.moves,
        simulates=cls.simulates,
        records=cls.records,
        on_probation=cls.on_probation,
        same_params=dict(cls.same_params),
    )


def _successors_named(params: type, given: Mapping[str, Any]) -> dict[str, Successors]:
    """Return what given parameters name to take a node's place, by parameter."""
    info = msgspec.inspect.type_info(params)
    assert isinstance(info, msgspec.inspect.StructType)
    found = {}
    for field in info.fields:
        extra = field.type.extra or {} if isinstance(field.type, msgspec.inspect.Metadata) else {}
        if "successors" in extra and field.encode_name in given:
            node, runs_of = extra["successors"]
            found[field.encode_name] = Successors(node, list(runs_of(given[field.encode_name])))
    return found


def _port(port: Port) -> NodePort:
    types = list(map(MessageType.of, port.messages))
    if isinstance(port, Sub):
        return NodePort(port.name, port.kind, types, port.qos, port.optional, port.lasting)
    return NodePort(port.name, port.kind, types, port.qos if isinstance(port, Pub) else Qos())


def _module(name: str, workspace: Path) -> ModuleType:
    if name.endswith(".py"):
        return _module_at(workspace / name, workspace)
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        if name != missing and not name.startswith(f"{missing}."):
            raise
        under = "".join(f", nor in the installed '{underlay.name}'" for underlay in underlays())
        raise _Refusal(f"no module '{name}' in {workspace}{under}{_near_module(name, workspace)}") from error
    wanted = workspace.joinpath(*name.split(".")).with_suffix(".py")
    if wanted.is_file() and module.__file__ is not None and not wanted.samefile(module.__file__):
        package = name.partition(".")[0]
        message = f"'{name}' was imported from {module.__file__}, not from the workspace"
        raise _Refusal(f"{message}; add an empty {package}/__init__.py to the workspace")
    return module


def _module_at(path: Path, workspace: Path) -> ModuleType:
    if not path.exists():
        files = [file.name for file in path.parent.glob("*.py")]
        match = nearest(path.name, files)
        raise _Refusal(f"no file {path}" + (f"; did you mean '{match}'?" if match else "; check the path"))
    try:
        check_regular(path, LARGEST_MODULE_BYTES)
    except OSError as error:
        raise _Refusal(f"{path} cannot be read: {error.strerror}") from error
    return load_module(str(path), str(workspace))


def _near_module(name: str, workspace: Path) -> str:
    if name.isidentifier() and Path(f"{name}.py").is_file():
        return f"; write {name}.py:CLASS for the file that is where you are"
    folders = [workspace, *(underlay.folder for underlay in underlays())]
    files = [path for folder in folders for path in (folder / "nodes").glob("*.py")]
    known = [f"nodes.{path.stem}" for path in files if path.stem != "__init__"]
    parent = name.rpartition(".")[0]
    with contextlib.suppress(Exception, SystemExit):
        found = importlib.util.find_spec(parent) if parent else None
        if found is not None and found.submodule_search_locations is not None:
            known += [
                f"{parent}.{module.name}" for module in pkgutil.iter_modules(found.submodule_search_locations)
            ]
    return hint(name, known)


def _class(module: ModuleType, module_name: str, name: str) -> type[Node]:
    found = getattr(module, name, None)
    if isinstance(found, type) and issubclass(found, Node) and found is not Node:
        return found
    classes = [
        key
        for key, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, Node) and value is not Node
    ]
    if found is not None:
        nodes = f" (nodes there: {', '.join(classes)})" if classes else ""
        raise _Refusal(f"'{name}' in {module_name} is not a node; derive it from palp_core.Node{nodes}")
    raise _Refusal(f"no class '{name}' in {module_name}{hint(name, classes)}")


def _function(module: ModuleType, module_name: str, name: str) -> None:
    if not callable(getattr(module, name, None)):
        functions = [
            key for key, value in vars(module).items() if callable(value) and not key.startswith("_")
        ]
        raise _Refusal(f"no function '{name}' in {module_name}{hint(name, functions)}")


def _located(error: BaseException, workspace: Path) -> str:
    """Return an exception's text with the line of the workspace's source that raised it."""
    if isinstance(error, SystemExit):
        text = f"the module ends the process when it is imported (exit status {error.code}); remove that call"
    else:
        text = f"{type(error).__name__}: {error}".removesuffix(": ")
    if isinstance(error, SyntaxError):  # of no line where the file has a NUL byte
        where = f"{_short(error.filename, workspace)}:{error.lineno or 1}: " if error.filename else ""
        return f"{where}SyntaxError: {error.msg}"
    if isinstance(error, ModuleNotFoundError) and (installs := advice(error)):
        return installs  # without the place, so that it is reported once for all nodes
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if _is_within(frame.filename, workspace)]
    place = (own or frames)[-1]
    return f"{_short(place.filename, workspace)}:{place.lineno}: {text}"


def _is_within(file: str, workspace: Path) -> bool:
    path = Path(file)
    foreign = "site-packages" in path.parts or path.is_relative_to(_LIBRARY)
    return path.is_relative_to(workspace) and not foreign


def _short(file: str, workspace: Path) -> str:
    path = Path(file)
    return str(path.relative_to(workspace)) if path.is_relative_to(workspace) else file


def param_errors(node: Declaration, given: Mapping[str, Any]) -> dict[str, str]:
    """Return the first mistake of each parameter, also of a missing one, by name; "" for several together."""
    kinds = typing.get_type_hints(node.params, include_extras=True)
    declared = describe_params(node.params)
    errors = {}
    for name, value in given.items():
        if name not in declared:
            errors[name] = f"there is no parameter '{name}'{hint(name, declared)}"
            continue
        try:
            msgspec.convert(value, kinds[name])
        except msgspec.ValidationError as error:
            errors[name] = (
                f"parameter '{name}' does not fit: {in_words(error)}; {_wanted(declared[name], value)}"
            )
    meant = {nearest(name, declared) for name in errors if name not in declared}
    for name, param in declared.items():
        if param.required and name not in given and name not in meant:
            errors[name] = f"parameter '{name}' has no default; give it under params ({param.type})"
    if not errors:
        try:
            load_params(node, given, node.params.__name__)
        except GraphError as error:
            errors[""] = str(error)
    return errors


def _wanted(param: ParamDescription, value: Any) -> str:
    unit = f" in {param.unit}" if param.unit not in ("", "1") else ""
    low, high = param.minimum, param.maximum  # one alone is in the error
    bounds = "" if low is None or high is None else f" from {low:g} to {high:g}"
    return f"give {param.type}{bounds}{unit}, not {value!r:.60}"
