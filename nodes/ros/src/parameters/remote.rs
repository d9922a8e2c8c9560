//! Parameters of another node.

use crate::{Client, Endpoint, EndpointSpec, Error, Node, ParameterType, Qos};
use wm_msgs::rcl_interfaces::{
    Parameter, ParameterValue, SetParameters, SetParametersRequest, SetParametersResult,
};

/// Sets parameters of another node, by its service `~/set_parameters`.
pub struct RemoteParameters(Client<SetParameters>);

impl RemoteParameters {
    /// The parameters of `node`, a name within the namespace of `of`, or an absolute one.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    pub fn new(of: &Node, node: &str) -> Result<Self, Error> {
        let name = format!("{node}/set_parameters");
        Ok(Self(of.client(&name)?))
    }

    /// Waits until the node is running.
    pub async fn wait_for_service(&self) {
        self.0.wait_for_service().await;
    }

    /// Sets a parameter, and waits for the response without a limit: add a timeout. The inner error is the node's reason.
    ///
    /// # Errors
    /// As [`Client::call`].
    pub async fn set<T: ParameterType>(
        &self,
        name: &str,
        value: T,
    ) -> Result<Result<(), String>, Error> {
        let parameter = Parameter {
            name: name.to_owned(),
            value: ParameterValue::from(value.into_value()),
        };
        let request = SetParametersRequest {
            parameters: vec![parameter],
        };
        let response = self.0.call(&request).await?;
        Ok(match response.results.into_iter().next() {
            Some(SetParametersResult { successful, .. }) if successful => Ok(()),
            Some(SetParametersResult { reason, .. }) => Err(reason),
            None => Err("expected one result, got none".to_owned()),
        })
    }
}

/// Of the node with this name.
impl Endpoint for RemoteParameters {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        Client::<SetParameters>::specs(&format!("{name}/set_parameters"), qos, text)
    }

    fn make(node: &Node, name: &str, _: Qos) -> Result<Self, Error> {
        Self::new(node, name)
    }
}
