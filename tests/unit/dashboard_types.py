"""Reads a dashboard with the types of Grafana's foundation SDK, and finds what they do not know.

The SDK loses keys that it does not know, and checks no value; pydantic does, by the annotations of its constructors. It
has no types for lists of alerts, the options of transformations and the values of overrides, so those are not checked.
"""

from __future__ import annotations

import json
from typing import Any

from grafana_foundation_sdk.cog import runtime
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models import bargauge, common, prometheus, stat, statetimeline, table, timeseries
from grafana_foundation_sdk.models import dashboard as grafana
from pydantic import ValidationError, validate_call
from pydantic_core import core_schema

from tests.seeing.dashboards import panels

PANELS = (bargauge, stat, statetimeline, table, timeseries)
UNTYPED_PANELS = {"alertlist"}
# Keys of an annotation that only Grafana's data source for Prometheus reads.
OF_PROMETHEUS = {"step", "tagKeys", "textFormat", "titleFormat"}


def _schema(kind, *_):
    """Return how pydantic checks a value of one of the SDK's classes; where the SDK left JSON unread, this reads it."""
    return core_schema.no_info_before_validator_function(
        lambda value: kind.from_json(value) if isinstance(value, dict) else value, core_schema.is_instance_schema(kind)
    )


def _check_constructors():
    runtime.register_dataquery_variant(prometheus.variant_config())
    for module in PANELS:
        runtime.register_panelcfg_variant(module.variant_config())
    modules = (common, grafana, prometheus, *PANELS)
    kinds: set[Any] = {each for module in modules for each in vars(module).values() if hasattr(each, "from_json")}
    for kind in kinds:
        kind.__get_pydantic_core_schema__ = classmethod(_schema)
    for kind in kinds:
        kind.__init__ = validate_call(config={"arbitrary_types_allowed": True})(kind.__init__)


_check_constructors()


def strangers(document):
    """Yield what of a dashboard is unknown to Grafana, or of another type."""
    kinds = {panel["type"] for panel in panels(document)} - UNTYPED_PANELS
    yield from (kind for kind in kinds if runtime.panelcfg_config(kind) is None)
    try:
        read = JSONEncoder().encode(grafana.Dashboard.from_json(document))
    except (KeyError, TypeError, ValidationError) as error:
        yield repr(error)
    else:
        yield from _lost(document, json.loads(read), "")


def _lost(written, read, place):
    if isinstance(written, dict) and isinstance(read, dict):
        for key, value in written.items():
            if key in read:
                yield from _lost(value, read[key], f"{place}.{key}")
            elif value is not None and not (place.startswith(".annotations.list") and key in OF_PROMETHEUS):
                yield f"{place}.{key}"
    elif isinstance(written, list) and isinstance(read, list):
        for number, (value, found) in enumerate(zip(written, read, strict=True)):
            yield from _lost(value, found, f"{place}.{number}")
    elif written != read or isinstance(written, bool) is not isinstance(read, bool):
        yield f"{place}: {written!r} is read as {read!r}"
