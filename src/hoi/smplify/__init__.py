"""Body fit (section 3.1): SMPLify from image keypoints, Eqs. 1 and 2."""
