"""Every number of the generated data set."""

from pydantic import Field

from hoi.settings import Settings

Range = tuple[float, float]


class CameraConfig(Settings):
    """Where the photographer stands. BEHAVE's Kinects stand on tripods around the scene."""

    height_m: Range = Field(default=(1.2, 1.6), description="above the floor")
    distance_m: Range = Field(
        default=(2.0, 3.5), description="horizontal, to the middle of the pair"
    )
    pitch_deg: Range = Field(default=(0.0, 16.0), description="how far the camera looks down")
    roll_sd_deg: float = Field(default=1.0, ge=0)
    pan_m: float = Field(
        default=0.5, ge=0, description="the pair is this far off the optical axis at most"
    )


class KeypointNoiseConfig(Settings):
    """Simulated OpenPose: true joints, plus the errors a detector would make."""

    visible_sd: float = Field(
        default=0.0055, ge=0, description="of the person's height in the image"
    )
    hidden_sd: float = Field(
        default=0.018, ge=0, description="the same for joints behind something"
    )
    visible_drop: float = Field(default=0.01, ge=0, le=1, description="share reported as not found")
    hidden_drop: float = Field(default=0.25, ge=0, le=1)


class RenderConfig(Settings):
    """Ray caster and simulated camera."""

    shadow_rays: int = Field(
        default=2, ge=1, description="towards the key light, per half-size pixel"
    )
    bounce_rays: int = Field(default=4, ge=1, description="of ambient light, per half-size pixel")
    blur_px: float = Field(default=0.8, ge=0, description="lens blur at 2048 pixels width")
    noise: float = Field(default=0.008, ge=0, description="sensor noise, of full scale")
    jpeg_quality: int = Field(default=92, ge=30, le=100)


class BehaveMiniConfig(Settings):
    """The generated data set. Frames of one seed are the same whatever else is generated."""

    seed: int = Field(default=2022, ge=0)
    frames_per_action: int = Field(default=4, ge=1, description="per table row and split")
    image_width: int = Field(
        default=2048, ge=128, le=2048, multiple_of=8, description="height is 3/4"
    )
    min_visible_fraction: float = Field(
        default=0.3, ge=0, le=1, description="of the object [CHORE]"
    )
    max_attempts: int = Field(
        default=400, ge=1, description="stagings tried before a frame is given up"
    )
    betas_sd: float = Field(default=0.8, ge=0, description="spread of body shapes")
    pose_jitter_rad: float = Field(
        default=0.05, ge=0, description="per joint axis, before hands reach"
    )
    reach_tolerance_m: float = Field(default=0.035, gt=0, description="hand to its contact point")
    max_depth_m: float = Field(default=0.035, gt=0, description="deepest object point in the body")
    max_inside_share: float = Field(
        default=0.02, ge=0, le=1, description="object surface > 1.5 cm inside"
    )
    camera: CameraConfig = CameraConfig()
    keypoints: KeypointNoiseConfig = KeypointNoiseConfig()
    render: RenderConfig = RenderConfig()

    @property
    def image_height(self) -> int:
        return self.image_width * 3 // 4
