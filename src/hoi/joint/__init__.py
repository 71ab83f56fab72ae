"""Joint optimisation of object and body [3.4, Eq. 5]: contact, normals, penetration, size, image."""
