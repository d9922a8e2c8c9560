use clap::{Args, ValueEnum};
use wm_import::{ActionForm, ActionMapping, GripperRange};

/// Options that map the action values of a data set to dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper \[0..1\].
#[derive(Args, Clone, Copy, Debug)]
#[command(next_help_heading = "Action values that are not m, rad and 0..1")]
pub struct MappingOptions {
    /// First six action values: delta, the change to the next frame; absolute, a pose; velocity, per second
    #[arg(long, value_enum, default_value_t = Form::Delta)]
    actions: Form,
    /// Gripper values when closed and when open, for example -1:1, 0:0.8, 0:100, or 1:0 if 0 is open [default: 0:1, or 1:0
    /// for DROID]
    #[arg(long, value_name = "CLOSED:OPEN", allow_hyphen_values = true)]
    gripper_range: Option<GripperRange>,
    /// Metres in one unit of dx, dy, dz, for example 0.001 for mm
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = parse_scale)]
    translation_scale: f32,
    /// Radians in one unit of droll, dpitch, dyaw, for example 0.0174533 for degrees
    #[arg(long, value_name = "RADIANS", default_value_t = 1.0, value_parser = parse_scale)]
    rotation_scale: f32,
}

/// Meaning of the first six values.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Form {
    Delta,
    Absolute,
    Velocity,
}

impl MappingOptions {
    pub fn mapping(&self) -> ActionMapping {
        ActionMapping {
            form: match self.actions {
                Form::Delta => ActionForm::Delta,
                Form::Absolute => ActionForm::Absolute,
                Form::Velocity => ActionForm::Velocity,
            },
            translation_scale: self.translation_scale,
            rotation_scale: self.rotation_scale,
            gripper: self.gripper_range,
        }
    }
}

fn parse_scale(text: &str) -> Result<f32, String> {
    let scale = text.parse::<f32>().ok();
    scale
        .filter(|scale| scale.is_finite() && *scale > 0.0)
        .ok_or_else(|| format!("expected a number above 0, got {text:?}"))
}
