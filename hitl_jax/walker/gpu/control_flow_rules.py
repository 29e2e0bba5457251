"""Rules for a jaxpr's loops and branches."""

from typing import Any

import numpy as np

from hitl_jax.walker.gpu.exchange import ExchangingLanes
from hitl_jax.walker.gpu.registers import array_of, elements_of, elements_of_all


class ControlFlowRules(ExchangingLanes):
    """The rules; each is named as its primitive, and takes an equation and its operands' values."""

    def _while(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        of_test, of_body = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        test_consts, body_consts = given[:of_test], given[of_test : of_test + of_body]
        carry = self.copied(given[of_test + of_body :])
        with self._writer.loop() as end:
            (test,) = self.run_closed(eqn.params["cond_jaxpr"], [*test_consts, *carry])
            self._writer.branch(end, unless=self.goes_on(elements_of(test)[0]))
            after = self.run_closed(eqn.params["body_jaxpr"], [*body_consts, *carry])
            self._writer.move_all(elements_of_all(carry), elements_of_all(after))
        return carry

    def _scan(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        closed = eqn.params["jaxpr"]
        if eqn.params["reverse"]:
            raise NotImplementedError("a scan from behind in a kernel")
        inside = [atom.aval.shape for atom in closed.jaxpr.invars]
        if inside != [atom.aval.shape for atom in eqn.invars]:
            return self._unrolled(eqn, given, inside)
        results = [atom.aval.shape for atom in closed.jaxpr.outvars]
        if results != [atom.aval.shape for atom in eqn.outvars]:
            raise NotImplementedError("a scan over nothing that tells of each step, in a kernel")
        num_consts = len(given) - len(eqn.outvars)
        count = self.copied([array_of([np.int32(0)], ())])[0]
        carry = self.copied(given[num_consts:])
        with self._writer.loop() as end:
            (made,) = elements_of(count)
            goes = self._writer.operate("lt", made, np.int32(eqn.params["length"]))
            self._writer.branch(end, unless=goes)
            after = self.run_closed(closed, [*given[:num_consts], *carry])
            following = self._writer.operate("add", made, np.int32(1))
            self._writer.move_all(
                [made, *elements_of_all(carry)], [following, *elements_of_all(after)]
            )
        return carry

    def _unrolled(
        self, eqn: Any, given: list[np.ndarray], inside: list[tuple[int, ...]]
    ) -> list[np.ndarray]:
        """A scan over arrays, unrolled."""
        closed = eqn.params["jaxpr"]
        scanned = [atom.aval.shape != shape for atom, shape in zip(eqn.invars, inside, strict=True)]
        results = [atom.aval.shape for atom in closed.jaxpr.outvars]
        num_carry = sum(
            atom.aval.shape == shape for atom, shape in zip(eqn.outvars, results, strict=True)
        )
        first = scanned.index(True)
        given, stacked_rows = list(given), []
        for place in range(eqn.params["length"]):
            rows = [
                array_of(elements_of(value[place : place + 1]), value.shape[1:]) if over else value
                for value, over in zip(given, scanned, strict=True)
            ]
            after = self.run_closed(closed, rows)
            given[first - num_carry : first] = after[:num_carry]
            stacked_rows.append(after[num_carry:])
        stacked = [np.stack(column) for column in zip(*stacked_rows, strict=True)]
        return [*given[first - num_carry : first], *stacked]

    def _cond(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        which, *operands = given
        no, yes = eqn.params["branches"]
        other, end = self._writer.label(), self._writer.label()
        condition = self._writer.convert(elements_of(which)[0], "pred")
        self._writer.branch(other, unless=condition)
        before, self._in_branch = self._in_branch, True
        results = self.copied(self.run_closed(yes, operands))
        self._writer.branch(end)
        self._writer.write(f"{other}:")
        self._writer.move_all(
            elements_of_all(results), elements_of_all(self.run_closed(no, operands))
        )
        self._writer.write(f"{end}:")
        self._in_branch = before
        return results
