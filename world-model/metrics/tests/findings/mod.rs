//! Outputs can be read back, lose nothing, and never turn text into markup.

mod compared;
mod machine;
mod reading;
mod report;
mod sample;
