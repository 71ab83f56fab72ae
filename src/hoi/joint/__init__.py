"""Joint optimisation of object and body [3.4]: contact, normals, penetration, size, image."""
