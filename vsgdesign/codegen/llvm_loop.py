"""The loop around the samples as LLVM's text: groups, stretches between the records of a program, samples."""

from __future__ import annotations

from vsgdesign.codegen.llvm_body import Body, Kept, Surroundings, product_lines
from vsgdesign.codegen.llvm_values import Printer, Scope
from vsgdesign.codegen.loop_spec import LoopSpec

NAME = "loop"

INTEGERS = (
    "begin",
    "end",
    "groups",
    "rows_group",
    "period",
    "fed_group",
    "fed_sample",
    "ring_size",
    "log_group",
    "log_sample",
    "every",
    "origin",
)
"""Arguments that are whole numbers; strides count doubles."""

POINTERS = (
    "rows", "uniform", "cyclic", "cycle", "fed", "rings", "ring_length", "log",
    "first", "at", "lane", "row", "count", "source", "values", "done",
)  # fmt: skip
"""Arguments that are arrays; the last eight are the program."""

_NEVER = 1 << 62


def loop_text(spec: LoopSpec, name: str = NAME) -> str:
    """The module with the function ``name``, which takes a pointer to its arguments (:data:`INTEGERS`, then
    :data:`POINTERS`, 64 bits each) and gives the number of samples that it has done."""
    spec.check()
    printer = Printer(spec.width, spec.strict)
    entry = Scope()
    stretch = Scope(entry)
    around = Surroundings(
        spec, printer, entry, stretch, Kept("%once", printer, entry, False), Kept("%lanes", printer, stretch, True)
    )
    bodies = [_sample(Body(around, block), at) for at, block in enumerate(spec.bodies)]
    arguments = [*(f"i64 %{name}" for name in INTEGERS), *(f"ptr noalias %{name}" for name in POINTERS)]
    lines = [
        *sorted(printer.declared),
        *(text for _, text in printer.rows.values()),
        *_entrance(name),
        f"define internal i64 @all.groups({', '.join(arguments)}) #0 {{",
        "entry:",
        f"  %once = alloca double, i64 {around.once.size}, align 64",
        f"  %lanes = alloca double, i64 {around.lanes.size}, align 64",
        f"  %products = alloca double, i64 {max(1, len(spec.multiplied) * spec.width)}, align 64",
        *entry.lines,
        *(_own_slots(spec) if spec.slot else []),
        "  br label %group",
        *_group(spec),
        *_program(spec),
        *_stretch(spec, stretch.lines),
        *_sample_head(spec, printer),
        *(line for body in bodies for line in body),
        *_sample_end(spec),
        "}",
        'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }',
        "",
    ]
    return "\n".join(lines)


def _entrance(name: str) -> list[str]:
    """Takes the arguments from memory: a call from Python with one argument costs a tenth of one with thirty."""
    lines, given = [f"define i64 @{name}(ptr %given) {{"], []
    for at, one in enumerate((*INTEGERS, *POINTERS)):
        kind = "i64" if one in INTEGERS else "ptr"
        lines += [
            f"  %place_{one} = getelementptr i64, ptr %given, i64 {at}",
            f"  %{one} = load {kind}, ptr %place_{one}",
        ]
        given.append(f"{kind} %{one}")
    return [*lines, f"  %samples = call i64 @all.groups({', '.join(given)})", "  ret i64 %samples", "}"]


def _whole(spec: LoopSpec) -> str:
    return f"<{spec.width} x i64>" if spec.width > 1 else "i64"


def _own_slots(spec: LoopSpec) -> list[str]:
    """How far apart the logs of the lanes of a group are, and the last slot of each."""
    kind, lanes = _whole(spec), ", ".join(f"i64 {lane}" for lane in range(spec.width))
    room = [f"  %log_room = sdiv i64 %log_sample, {len(spec.logged)}", "  %log_end = sub i64 %log_room, 1"]
    if spec.width == 1:
        return [*room, "  %log_last = add i64 %log_end, 0", "  %log_apart = add i64 0, 0"]
    spread, zeros = [], f"<{spec.width} x i32> zeroinitializer"
    for name, value in (("last", "%log_end"), ("from", "%log_sample")):
        spread += [
            f"  %log_{name}_one = insertelement {kind} poison, i64 {value}, i64 0",
            f"  %log_{name} = shufflevector {kind} %log_{name}_one, {kind} poison, {zeros}",
        ]
    return [*room, *spread, f"  %log_apart = mul {kind} %log_from, <{lanes}>"]


def _group(spec: LoopSpec) -> list[str]:
    """Groups one after the other, each over all samples."""
    rings = len(spec.rings) * spec.width
    return [
        "group:",
        "  %g = phi i64 [ 0, %entry ], [ %g_next, %group_end ]",
        "  %base_at = mul i64 %g, %rows_group",
        "  %base = getelementptr double, ptr %rows, i64 %base_at",
        "  %fed_at = mul i64 %g, %fed_group",
        "  %fed_first = getelementptr double, ptr %fed, i64 %fed_at",
        "  %log_at = mul i64 %g, %log_group",
        "  %log_first = getelementptr double, ptr %log, i64 %log_at",
        *([f"  %log_lanes = getelementptr double, ptr %log_first, {_whole(spec)} %log_apart"] if spec.slot else []),
        "  %ring_count = mul i64 %g, %ring_size",
        f"  %ring_at = mul i64 %ring_count, {rings}",
        "  %ring_first = getelementptr double, ptr %rings, i64 %ring_at",
        *(
            [
                "  %length_place = getelementptr i64, ptr %ring_length, i64 %g",
                "  %length = load i64, ptr %length_place, align 8",
            ]
            if spec.rings
            else []
        ),
        "  %done_place = getelementptr i64, ptr %done, i64 %g",
        "  %record_first = load i64, ptr %done_place, align 8",
        "  %g_next = add i64 %g, 1",
        "  %last_place = getelementptr i64, ptr %first, i64 %g_next",
        "  %record_last = load i64, ptr %last_place, align 8",
        "  br label %stretch",
        "group_end:",
        "  store i64 %record, ptr %done_place, align 8",
        "  %more = icmp slt i64 %g_next, %groups",
        "  br i1 %more, label %group, label %finish",
        "finish:",
        "  %samples = sub i64 %until_done, %begin",
        "  ret i64 %samples",
    ]


def _program(spec: LoopSpec) -> list[str]:
    """A stretch begins with the records that are due; it ends before the next one."""
    return [
        "stretch:",
        "  %k_first = phi i64 [ %begin, %group ], [ %until_done, %stretch_end ]",
        "  %record_before = phi i64 [ %record_first, %group ], [ %record, %stretch_end ]",
        "  br label %due",
        "due:",
        "  %record = phi i64 [ %record_before, %stretch ], [ %record_next, %record_end ]",
        "  %any = icmp slt i64 %record, %record_last",
        "  br i1 %any, label %look, label %ready",
        "look:",
        "  %at_place = getelementptr i64, ptr %at, i64 %record",
        "  %when = load i64, ptr %at_place, align 8",
        "  %now = icmp sle i64 %when, %k_first",
        "  br i1 %now, label %record_begin, label %ready",
        "record_begin:",
        *(
            line
            for name in ("lane", "row", "count", "source")
            for line in (
                f"  %{name}_place = getelementptr i64, ptr %{name}, i64 %record",
                f"  %{name}_now = load i64, ptr %{name}_place, align 8",
            )
        ),
        f"  %row_at = mul i64 %row_now, {spec.width}",
        "  %cell = add i64 %row_at, %lane_now",
        "  %to = getelementptr double, ptr %base, i64 %cell",
        "  %given = icmp sge i64 %source_now, 0",
        "  %other_row = sub i64 -1, %source_now",
        f"  %other_at = mul i64 %other_row, {spec.width}",
        "  %other_cell = add i64 %other_at, %lane_now",
        "  %from_rows = getelementptr double, ptr %base, i64 %other_cell",
        "  %from_values = getelementptr double, ptr %values, i64 %source_now",
        "  %from = select i1 %given, ptr %from_values, ptr %from_rows",
        f"  %stride = select i1 %given, i64 1, i64 {spec.width}",
        "  br label %copy",
        "copy:",
        "  %c = phi i64 [ 0, %record_begin ], [ %c_next, %copy_one ]",
        "  %copying = icmp slt i64 %c, %count_now",
        "  br i1 %copying, label %copy_one, label %record_end",
        "copy_one:",
        "  %from_at = mul i64 %c, %stride",
        "  %from_cell = getelementptr double, ptr %from, i64 %from_at",
        "  %copied = load double, ptr %from_cell, align 8",
        f"  %to_at = mul i64 %c, {spec.width}",
        "  %to_cell = getelementptr double, ptr %to, i64 %to_at",
        "  store double %copied, ptr %to_cell, align 8",
        "  %c_next = add i64 %c, 1",
        "  br label %copy",
        "record_end:",
        "  %record_next = add i64 %record, 1",
        "  br label %due",
    ]


def _stretch(spec: LoopSpec, lines: list[str]) -> list[str]:
    """What a stretch computes before its samples."""
    text = [
        "ready:",
        "  %next_at = phi i64 [ %end, %due ], [ %when, %look ]",
        "  %sooner = icmp slt i64 %next_at, %end",
        "  %until = select i1 %sooner, i64 %next_at, i64 %end",
        *lines,
    ]
    if spec.cyclic or len(spec.bodies) > 1:
        text.append("  %turn_first = srem i64 %k_first, %period")
    if spec.rings:
        text.append("  %slot_first = srem i64 %k_first, %length")
    if spec.logged:
        text += [
            "  %logging = icmp sgt i64 %every, 0",
            f"  %every_safe = select i1 %logging, i64 %every, i64 {_NEVER}",
            "  %over = srem i64 %k_first, %every_safe",
            "  %on_time = icmp eq i64 %over, 0",
            "  %left_over = sub i64 %every_safe, %over",
            "  %wait_some = select i1 %on_time, i64 0, i64 %left_over",
            f"  %wait_first = select i1 %logging, i64 %wait_some, i64 {_NEVER}",
        ]
    return [*text, "  br label %sample"]


def _sample_head(spec: LoopSpec, printer: Printer) -> list[str]:
    """Counters, and the places of what depends on the sample's number."""
    text = ["sample:", "  %k = phi i64 [ %k_first, %ready ], [ %k_next, %next ]"]
    several = len(spec.bodies) > 1
    if spec.cyclic or several:
        text.append("  %turn = phi i64 [ %turn_first, %ready ], [ %turn_next, %next ]")
    if spec.rings:
        text.append("  %slot = phi i64 [ %slot_first, %ready ], [ %slot_next, %next ]")
    if spec.logged:
        text.append("  %wait = phi i64 [ %wait_first, %ready ], [ %wait_next, %next ]")
    if spec.cyclic:
        text += [
            f"  %cyclic_at = mul i64 %turn, {len(spec.cyclic)}",
            "  %cyclic_now = getelementptr double, ptr %cyclic, i64 %cyclic_at",
        ]
    if spec.rings:
        text += [
            f"  %slot_at = mul i64 %slot, {len(spec.rings) * spec.width}",
            "  %ring = getelementptr double, ptr %ring_first, i64 %slot_at",
        ]
    if spec.fed:
        text += [
            "  %fed_number = sub i64 %k, %begin",
            "  %fed_here = mul i64 %fed_number, %fed_sample",
            "  %fed_now = getelementptr double, ptr %fed_first, i64 %fed_here",
        ]
    if spec.index:
        text += ["  %since = sub i64 %k, %origin", "  %index = sitofp i64 %since to double"]
    text += product_lines(spec, printer)
    if not several:
        return [*text, "  br label %body_0"]
    others = " ".join(f"i64 {at}, label %body_{at}" for at in range(1, len(spec.bodies)))
    return [
        *text,
        "  %body_place = getelementptr i64, ptr %cycle, i64 %turn",
        "  %body_number = load i64, ptr %body_place, align 8",
        f"  switch i64 %body_number, label %body_0 [ {others} ]",
    ]


def _sample(body: Body, number: int) -> list[str]:
    """One kind of sample, with its log."""
    logged, slot, stop = body.print()
    spec, printer, scope = body.spec, body.printer, body.scope
    if stop is not None:
        kind, flags = printer.type(True), printer.type(True, True)
        zero = "0.0" if spec.width == 1 else "zeroinitializer"
        raised = printer.line(scope, f"fcmp une {kind} {stop.text}, {zero}")
        if spec.width > 1:
            bits = printer.line(scope, f"bitcast {flags} {raised} to i{spec.width}")
            raised = printer.line(scope, f"icmp ne i{spec.width} {bits}, 0")
        scope.lines.append(f"  %stop_{number} = or i1 {raised}, false")
    if not spec.logged:
        return [f"body_{number}:", *scope.lines, f"  br label %end_{number}", f"end_{number}:", "  br label %next"]
    log = Scope(scope)
    if slot is not None:
        printer.scatter(log, "%log_lanes", slot, "%log_last", len(logged), logged)
    else:
        log.lines += [
            f"  %log_slot_{number} = sdiv i64 %k, %every_safe",
            f"  %log_here_{number} = mul i64 %log_slot_{number}, %log_sample",
            f"  %log_now_{number} = getelementptr double, ptr %log_first, i64 %log_here_{number}",
        ]
        for at, value in enumerate(logged):
            printer.store(log, f"%log_now_{number}", at * spec.width, value)
    return [
        f"body_{number}:",
        *scope.lines,
        f"  %logs_{number} = icmp eq i64 %wait, 0",
        f"  br i1 %logs_{number}, label %log_{number}, label %end_{number}",
        f"log_{number}:",
        *log.lines,
        f"  br label %end_{number}",
        f"end_{number}:",
        "  br label %next",
    ]


def _sample_end(spec: LoopSpec) -> list[str]:
    """Counters of the next sample, and whether there is one."""
    text = ["next:"]
    if spec.stop:
        pairs = ", ".join(f"[ %stop_{at}, %end_{at} ]" for at in range(len(spec.bodies)))
        text.append(f"  %stopped = phi i1 {pairs}")
    text.append("  %k_next = add i64 %k, 1")
    for name, period, there in (
        ("turn", "%period", bool(spec.cyclic) or len(spec.bodies) > 1),
        ("slot", "%length", bool(spec.rings)),
    ):
        if there:
            text += [
                f"  %{name}_more = add i64 %{name}, 1",
                f"  %{name}_round = icmp eq i64 %{name}_more, {period}",
                f"  %{name}_next = select i1 %{name}_round, i64 0, i64 %{name}_more",
            ]
    if spec.logged:
        text += [
            "  %waited = icmp eq i64 %wait, 0",
            "  %wait_from = select i1 %waited, i64 %every_safe, i64 %wait",
            "  %wait_next = sub i64 %wait_from, 1",
        ]
    text.append("  %going = icmp slt i64 %k_next, %until")
    if spec.stop:
        text += ["  %not_stopped = xor i1 %stopped, true", "  %on = and i1 %going, %not_stopped"]
    text += [
        f"  br i1 {'%on' if spec.stop else '%going'}, label %sample, label %stretch_end",
        "stretch_end:",
        "  %until_done = add i64 %k, 1",
        "  %further = icmp slt i64 %until_done, %end",
    ]
    if spec.stop:
        text.append("  %again = and i1 %further, %not_stopped")
    text.append(f"  br i1 {'%again' if spec.stop else '%further'}, label %stretch, label %group_end")
    return text
