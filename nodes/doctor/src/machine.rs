//! Facts about the machine from `/proc` and `/sys`.

use crate::{
    DoctorError, Finding,
    buffers::{self, Buffers},
    clock::{self, SystemClock},
    memory::{self, Memory},
    network::{self, Network},
    processor::{self, Processor},
    survey::Survey,
};
use wm_ros::Environment;

/// The machine, its clock and its network.
#[derive(Clone, Debug)]
pub struct Machine {
    pub(crate) processor: Processor,
    pub(crate) memory: Memory,
    pub(crate) clock: SystemClock,
    pub(crate) buffers: Buffers,
    pub(crate) network: Network,
}

impl Machine {
    /// Reads the facts. Call it before [`listen`](crate::listen), during which losses are counted.
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

    /// The findings after listening.
    #[must_use]
    pub fn check(&self, survey: &Survey) -> Vec<Finding> {
        let mut findings = processor::check(&self.processor);
        findings.extend(memory::check(&self.memory));
        findings.extend(network::check(&self.network, survey.is_silent()));
        findings.extend(buffers::check(&self.buffers, survey));
        findings.extend(clock::check(&self.clock, &self.network.reach, survey));
        findings
    }
}
