"""ROKAE xCore: External Communication, which the vendor documents, and the objects of its SDK over a stream of ours."""

from __future__ import annotations

from gateway.api.vendor import Protocol, Vendor
from vendors.xcore import (
    external,
    external_options,
    external_signals,
    external_words,
    stream,
    stream_record,
    stream_signals,
)
from vendors.xcore.documents import COMMANDS

EXTERNAL = Protocol(
    name="external",
    title="External Communication, one word at a time, either side calling",
    port=None,
    records=(external_words.RECORD,),
    signals=external_signals.SIGNALS,
    options=external_options.ExternalOptions,
    make_reader=external.make_reader,
    make_observer=external.make_observer,
    make_decoders=external.make_decoders,
    rate_hz=10.0,
    max_rate_hz=100.0,
    quiet=0.5,
    slowest_s=external_options.slowest_s,
    stale_s=5.0,
    outgoing=(external_options.OUTGOING,),
    when_refused=(
        "External communication is off until it is switched on at the HMI (Communication > External communication), "
        "with a port of your choice. One of the two sides is the server, the other one calls: "
        "`role` below [robots.external] says which this gateway is"
    ),
)

OBJECTS = Protocol(
    name="objects",
    title="Objects of the vendor's SDK, from the agent beside it (our own stream)",
    port=5920,
    records=(stream_record.RECORD,),
    signals=stream_signals.SIGNALS,
    options=stream.ObjectsOptions,
    make_reader=stream.make_reader,
    make_decoders=stream.make_decoders,
    tick_s=stream.TICK_S,
    stale_s=3.0,
    outgoing=(stream.OUTGOING,),
    wall_clock=stream_signals.WALL_CLOCK,
    commands=True,
    when_refused=(
        "no agent listens there: start robot-gateway-xcore-agent, or wrap the robot in the application that drives it; "
        "see the README of the agent"
    ),
)

VENDOR = Vendor(name="xcore", title="ROKAE xCore", protocols=(EXTERNAL, OBJECTS), documents=(COMMANDS,))
