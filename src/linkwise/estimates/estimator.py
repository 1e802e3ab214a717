"""Estimators: methods of identification with their options."""

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

    Concrete classes are frozen dataclasses: `MaximumLikelihood`, `WeakForm` and `PhysicsInformedSindy`.

    Attributes
    ----------
    method : str
        Name of the method, which `identify` also takes and estimates carry; set on the class.

    Examples
    --------
    >>> import linkwise as lw
    >>> isinstance(lw.WeakForm(), lw.Estimator), lw.WeakForm.method
    (True, 'weak')
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
        """The record, for a method that takes a single one.

        Parameters
        ----------
        records : sequence of Record
            The records given.

        Returns
        -------
        Record
            The only one.

        Raises
        ------
        IdentificationError
            If there are several.
        """
        if len(records) > 1:
            raise IdentificationError(
                f'several records are for method "ml", not for "{self.method}", which takes one; got {len(records)}'
            )
        return records[0]
