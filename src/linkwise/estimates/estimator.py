"""What every method of identification is: frozen options, and the way from records to an estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record


class Estimator(ABC):
    """A method of identification with its options; `identify` takes one as `method`.

    Concretes are frozen dataclasses: `MaximumLikelihood`, `WeakForm` and `PhysicsInformedSindy`.
    """

    method: ClassVar[str]
    """Its name: what `identify` takes as text, and what its estimates carry."""

    @abstractmethod
    def estimate(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """Estimate the unknowns of a structure.

        Parameters
        ----------
        records : sequence of Record
            One or more records of the structure.
        structure : Structure
            The structure, with one unknown at least.
        progress : Progress
            Called with a `ProgressReport` at every step of an iteration.

        Returns
        -------
        Estimate
            The answer; its `seconds` are those of the call only where `identify` makes it.

        Raises
        ------
        IdentificationError
            If the records do not determine the unknowns at all, or there are more of them than the method takes.
        """

    def only_record(self, records: Sequence[Record]) -> Record:
        """The one record; IdentificationError where there are several, for a method that takes one."""
        if len(records) > 1:
            raise IdentificationError(
                f'several records are for method "ml", not for "{self.method}", which takes one; got {len(records)}'
            )
        return records[0]
