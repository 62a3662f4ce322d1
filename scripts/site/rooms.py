"""An extension of Griffe: `trajopt.robot` is a package, although its stub says that it can be called."""

from typing import Any

import griffe

CALLABLE = "trajopt.robot"


class CallableRooms(griffe.Extension):
    """Leave out the attribute by which type checkers know that `trajopt.robot` can be called."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Remove the attribute, so that the package of that name is found."""
        if attr.path == CALLABLE and attr.parent is not None:
            attr.parent.del_member(attr.name)
