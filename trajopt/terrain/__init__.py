"""The ground: one plane, plane faces with edges, or a smooth height."""
