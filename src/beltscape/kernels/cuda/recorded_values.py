"""Arguments and result of a recorded function: what a recording puts in their places, and a graph puts back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from beltscape.kernels.cuda.arguments import Given, Replacements, Slot, fill, rebuild
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.recording import (
    ArrayReference,
    LaunchRecorder,
    NotRecordableError,
    RecordingWorkspace,
    refer,
)
from beltscape.kernels.cuda.storage import find_input
from beltscape.kernels.resident import ResidentArray


def separate(
    given: Sequence[ResidentArray], arrays: Sequence[DeviceArray], work: RecordingWorkspace
) -> list[DeviceArray]:
    """Return arrays of which no two lie in the same memory, unless they are the same one: in a graph they may not."""
    apart: list[DeviceArray] = []
    for i, array in enumerate(arrays):
        same = next((j for j in range(i) if given[j].identity == given[i].identity), None)
        if same is not None:
            apart.append(apart[same])
        elif any(each.block is array.block for each in arrays[:i]):
            apart.append(work.copy_argument(array))
        else:
            apart.append(array)
    return apart


def replace_given(
    given: Sequence[Any], recorder: LaunchRecorder, inputs: Sequence[DeviceArray], numbers: DeviceArray
) -> list[Any]:
    """Return the arguments with arrays, numbers and kernels that are recorded."""
    arrays = iter(inputs)
    parts = (numbers.part(i).reshaped(()) for i in range(numbers.size))
    replace = Replacements(
        lambda _: ResidentArray.from_device(next(arrays), recorder),
        lambda _: ResidentArray.from_device(next(parts), recorder),
        lambda kernels: type(kernels)(recorder),
    )
    return [rebuild(each, replace) for each in given]


def make_slots(
    result: Any,
    recorder: LaunchRecorder,
    inputs: Sequence[DeviceArray],
    numbers: DeviceArray,
    blocks: dict[int, DeviceArray],
) -> Any:
    """Return a result with slots for its arrays, and note the blocks of those that it computes."""
    references = [refer(each) for each in inputs]

    def of_array(array: Any) -> Slot:
        if not isinstance(array, ResidentArray):
            raise NotRecordableError(f"it returns an array of the processor {array.shape}")
        found = array.on_device(recorder.upload)
        reference = refer(found)
        index = find_input(references, reference)
        if index is not None:
            if reference == references[index]:
                return Slot("argument", index)
            return Slot("argument", index, reference._replace(offset=found.offset - inputs[index].offset))
        if found.block.serial not in recorder.recording.sizes:
            raise NotRecordableError(f"it returns a constant array {found.shape}")
        blocks[found.block.serial] = found
        return Slot("computed", reference=reference)

    def of_number(number: Any) -> Any:
        if not isinstance(number, ResidentArray):
            return number
        found = number.on_device(recorder.upload)
        if found.block is not numbers.block:
            return of_array(number)
        return Slot("number", found.offset // found.dtype.itemsize)

    return rebuild(result, Replacements(of_array, of_number, lambda _: Slot("kernels")))


def fill_result(
    result: Any,
    resident: Any,
    found: Given,
    find: Callable[[ArrayReference], DeviceArray],
    fixed: frozenset[int] = frozenset(),
) -> Any:
    """Return the result of a recorded function: its arrays by their references, or what it was given.

    ``fixed`` are the parts of `beltscape.kernels.cuda.arguments.find_fixed`, which stay as they are.
    """

    def of_slot(slot: Slot) -> Any:
        if slot.kind == "computed":
            return ResidentArray.from_device(find(slot.reference), resident)
        if slot.kind == "number":
            return found.numbers[slot.index]
        if slot.kind == "kernels":
            return found.kernels[0]
        argument = found.arrays[slot.index]
        if slot.reference is None:
            return argument
        whole, part = argument.on_device(resident.upload), slot.reference
        array = DeviceArray(whole.block, part.shape, part.dtype, whole.offset + part.offset)
        return ResidentArray.from_device(array, resident)

    return fill(result, of_slot, fixed)
