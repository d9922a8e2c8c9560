//! Parameters of another node.

use wm_msgs::cdr;

use crate::{
    Error, Node, ParameterType, RawClient,
    rcl_interfaces::{Parameter, ParameterValue, ParametersToSet, SetParametersResult, SetResults},
};

/// Sets parameters of another node, by its service `~/set_parameters`.
pub struct RemoteParameters(RawClient);

impl RemoteParameters {
    /// Those of `node`, a name within the namespace of `of`, or an absolute one.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn new(of: &Node, node: &str) -> Result<Self, Error> {
        let name = format!("{node}/set_parameters");
        let client = of.raw_client(&name, "rcl_interfaces/srv/SetParameters")?;
        Ok(Self(client))
    }

    /// Waits until the node is there.
    pub async fn wait_for_service(&self) {
        self.0.wait_for_service().await;
    }

    /// Sets a parameter, and waits for the answer for as long as it takes: bring a timeout. The inner error says why
    /// the node refuses.
    ///
    /// # Errors
    /// As [`RawClient::call`], or an answer of another type.
    pub async fn set<T: ParameterType>(
        &self,
        name: &str,
        value: T,
    ) -> Result<Result<(), String>, Error> {
        let parameter = Parameter {
            name: name.to_owned(),
            value: ParameterValue::from(value.into_value()),
        };
        let request = ParametersToSet {
            parameters: vec![parameter],
        };
        let answer = self.0.call(cdr::to_bytes(&request)?.into()).await?;
        let answer: SetResults = cdr::from_bytes(&answer)?;
        Ok(match answer.results.into_iter().next() {
            Some(SetParametersResult { successful, .. }) if successful => Ok(()),
            Some(SetParametersResult { reason, .. }) => Err(reason),
            None => Err("the answer is empty".to_owned()),
        })
    }
}
