"""Settings of the body fit.

Every term of the energy is a squared residual over the square of a standard deviation, so the
numbers here are lengths and angles one can judge, and every weight defaults to 1 as in Eq. 1
(E = E_J + E_theta + E_beta), which prints none.
"""

from typing import Literal

from pydantic import Field

from hoi.settings import Settings


class SmplifyConfig(Settings):
    """Energy, starts and schedule of SMPLify."""

    num_betas: int = Field(default=10, ge=1, le=300, description="shape components that are fitted")

    # which keypoints count
    min_confidence: float = Field(
        default=0.1, ge=0, le=1, description="keypoints below are ignored"
    )
    min_keypoints: int = Field(default=6, ge=4, le=21, description="fewer than this fail the frame")

    # energy: E_J (Eq. 2)
    keypoint_weight: float = Field(default=1.0, ge=0)
    keypoint_sd_m: float = Field(
        default=0.02, gt=0, description="keypoint error, as a length at the person's depth (metres)"
    )
    keypoint_robust_m: float = Field(
        default=0.12,
        gt=0,
        description="Geman-McClure scale of E_J at the end (metres at that depth)",
    )
    keypoint_robust_start_m: float = Field(
        default=0.6, gt=0, description="the same at the beginning"
    )

    # energy: E_theta
    pose_weight: float = Field(default=1.0, ge=0)
    pose_kernel_width: float = Field(
        default=0.14,
        gt=0,
        description="deviation around a database pose, as a share of joint range",
    )
    pose_broad_width: float = Field(
        default=0.30,
        gt=0,
        description="deviation around the mean pose for poses unlike all of them",
    )
    pose_broad_penalty: float = Field(
        default=30.0, ge=0, description="energy that a pose unlike all database poses costs"
    )
    limit_weight: float = Field(default=1.0, ge=0)
    limit_sd_deg: float = Field(default=5.0, gt=0, description="softness of the joint limits")

    # energy: E_beta
    shape_weight: float = Field(default=1.0, ge=0)

    # energy: additions to Eq. 1
    landmark_weight: float = Field(
        default=0.0,
        ge=0,
        description=(
            "weight of the detector's 3D landmarks, which say what is nearer; 0 uses them for "
            "starts alone, as the paper uses its initial regression. They understate depth: on 24 "
            "frames of the tuning split 0, 0.3 and 1 gave joint errors of 5.6, 6.9 and 9.0 cm"
        ),
    )
    landmark_sd_m: float = Field(default=0.08, gt=0, description="landmark error (metres)")
    landmark_unseen_weight: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description=(
            "least weight of a landmark: where a keypoint is hidden, the detector's guess at its "
            "place in space is still better than none"
        ),
    )
    landmark_robust_m: float = Field(
        default=0.3, gt=0, description="its Geman-McClure scale (metres)"
    )
    upright_weight: float = Field(default=1.0, ge=0)
    upright_sd_deg: float = Field(
        default=45.0,
        gt=0,
        description="how far the pelvis tilts from image-up; breaks near-ties only",
    )

    # starts
    given: Literal["start", "only_start", "result"] = Field(
        default="start",
        description="bodies of other systems (other_systems.<data set>.bodies). start: the fit "
        "starts from them, too; only_start: from nothing else, as the paper does with PARE's; "
        "result: joints and shape are kept, only where the body is and faces is fitted",
    )
    start_poses: int = Field(
        default=10, ge=1, description="database poses to start from, most different"
    )
    start_yaws: int = Field(default=8, ge=1, description="directions a start pose faces")
    kept_starts: int = Field(default=12, ge=1, description="starts that survive the camera solve")
    kept_after_coarse: int = Field(
        default=4, ge=1, description="starts that survive the coarse fit"
    )
    flip_rounds: int = Field(
        default=2, ge=0, description="rounds of trying limbs mirrored in depth on the best fit"
    )

    # schedule (Levenberg-Marquardt iterations; a step solves all parameters of all starts)
    camera_iterations: int = Field(default=5, ge=0)
    coarse_iterations: int = Field(default=12, ge=1)
    fine_iterations: int = Field(default=25, ge=1)
    flip_iterations: int = Field(default=8, ge=1)
    initial_damping: float = Field(default=1e-2, gt=0)
