//! The machine: what `/proc` and `/sys` say of it.

use crate::{
    DoctorError, Finding,
    buffers::{self, Buffers},
    clock::{self, SystemClock},
    heard::Heard,
    memory::{self, Memory},
    network::{self, Network},
    processor::{self, Processor},
};
use std::path::Path;
use wm_ros::Environment;

/// What is known of the machine, its clock and its network.
#[derive(Clone, Debug)]
pub struct Machine {
    pub(crate) processor: Processor,
    pub(crate) memory: Memory,
    pub(crate) clock: SystemClock,
    pub(crate) buffers: Buffers,
    pub(crate) network: Network,
}

impl Machine {
    /// Looks at the machine; to be done before [`listen`](crate::listen), during which losses are counted.
    ///
    /// # Errors
    /// `/proc` cannot be read, or the interfaces cannot be listed.
    pub fn look(environment: &Environment) -> Result<Self, DoctorError> {
        Ok(Self {
            processor: Processor::look()?,
            memory: Memory::look()?,
            clock: SystemClock::look(),
            buffers: Buffers::look()?,
            network: Network::look(environment)?,
        })
    }

    /// What is to be said of it, after `heard` was heard.
    #[must_use]
    pub fn check(&self, heard: &Heard) -> Vec<Finding> {
        let mut findings = processor::check(&self.processor);
        findings.extend(memory::check(&self.memory));
        findings.extend(network::check(&self.network, heard.is_silent()));
        findings.extend(buffers::check(&self.buffers, heard));
        findings.extend(clock::check(&self.clock, &self.network.reach, heard));
        findings
    }
}

/// The text of a file of the system.
pub(crate) fn read(file: &str) -> Result<String, DoctorError> {
    std::fs::read_to_string(file).map_err(|source| DoctorError::System {
        file: Path::new(file).to_owned(),
        source,
    })
}

/// The text of a file that not every system has, without the end of its line.
pub(crate) fn read_if_there(file: impl AsRef<Path>) -> Option<String> {
    let text = std::fs::read_to_string(file).ok()?;
    Some(text.trim_end().to_owned())
}
