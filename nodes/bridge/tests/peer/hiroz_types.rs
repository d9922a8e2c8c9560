//! ROS types for hiroz. It computes the hash of a message itself; hashes of services and actions are those of `wm_msgs`.
//!
//! hiroz 0.2.1 has lifecycle services of its own, but their hashes are not those of ROS 2, and their empty requests lack
//! the byte that IDL's empty structs have. So only their messages are used.

use hiroz::{
    MessageTypeInfo, ServiceTypeInfo,
    action::ZAction,
    entity::{TypeHash, TypeInfo},
    lifecycle::msgs::{ChangeStateRequest, ChangeStateResponse, GetStateResponse},
    msg::{SerdeCdrSerdes, ZMessage, ZService},
};
use serde::{Deserialize, Serialize};
use wm_msgs::{
    Action as _, Service, TypeDescription, action_msgs, lifecycle_msgs, std_srvs, wm_msgs::action,
};

/// `std_msgs/msg/String`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "std_msgs/msg/String")]
pub struct Text {
    pub data: String,
}

/// `std_srvs/srv/SetBool_Request`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "std_srvs/srv/SetBool_Request")]
pub struct SetBoolRequest {
    pub data: bool,
}

/// `std_srvs/srv/SetBool_Response`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "std_srvs/srv/SetBool_Response")]
pub struct SetBoolResponse {
    pub success: bool,
    pub message: String,
}

macro_rules! messages {
    ($($message:ty),*) => {$(
        impl ZMessage for $message {
            type Serdes = SerdeCdrSerdes<Self>;
        }
    )*};
}
messages!(Text, SetBoolRequest, SetBoolResponse);

fn hash(text: &str) -> TypeHash {
    TypeHash::from_rihs_string(text).unwrap()
}

/// The type of a service of `wm_msgs`.
fn service<S: Service>() -> TypeInfo {
    let description = TypeDescription::of_service::<S>().unwrap();
    let wire_name = format!("{}::srv::dds_::{}_", S::PACKAGE, S::NAME);
    TypeInfo::new(&wire_name, hash(&description.hash().to_string()))
}

macro_rules! services {
    ($($name:ident($of:ty): $request:ty => $response:ty),*) => {$(
        pub struct $name;

        impl ZService for $name {
            type Request = $request;
            type Response = $response;
        }

        impl ServiceTypeInfo for $name {
            fn service_type_info() -> TypeInfo {
                service::<$of>()
            }
        }
    )*};
}
services!(
    SetBool(std_srvs::SetBool): SetBoolRequest => SetBoolResponse,
    GetState(lifecycle_msgs::GetState): Ours<lifecycle_msgs::EmptyRequest> => GetStateResponse,
    ChangeState(lifecycle_msgs::ChangeState): ChangeStateRequest => ChangeStateResponse
);

/// A type of `wm_msgs` as one of hiroz.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Ours<T>(pub T);

impl<T> ZMessage for Ours<T>
where
    T: Serialize + for<'de> Deserialize<'de> + Send + Sync + 'static,
{
    type Serdes = SerdeCdrSerdes<Self>;
}

/// `wm_msgs/action/Plan`.
pub struct Plan;

/// The type of a part of the action, for example `SendGoal`.
fn part(name: &str) -> TypeInfo {
    let ros_name = format!("{}_{name}", action::Plan::ros_name());
    let dependencies = action::Plan::dependencies();
    let part = TypeDescription::action(&ros_name, action::Plan::DEFINITION, dependencies).unwrap();
    let wire_name = format!("wm_msgs::action::dds_::Plan_{name}_");
    TypeInfo::new(&wire_name, hash(&part.hash().to_string()))
}

impl ZAction for Plan {
    type Goal = Ours<<action::Plan as wm_msgs::Action>::Goal>;
    type Result = Ours<<action::Plan as wm_msgs::Action>::Result>;
    type Feedback = Ours<<action::Plan as wm_msgs::Action>::Feedback>;

    fn name() -> &'static str {
        "wm/plan"
    }

    fn send_goal_type_info() -> TypeInfo {
        part("SendGoal")
    }

    fn get_result_type_info() -> TypeInfo {
        part("GetResult")
    }

    fn feedback_type_info() -> TypeInfo {
        part("FeedbackMessage")
    }

    fn cancel_goal_type_info() -> TypeInfo {
        service::<action_msgs::CancelGoal>()
    }

    fn status_type_info() -> TypeInfo {
        let description = TypeDescription::of::<action_msgs::GoalStatusArray>().unwrap();
        let hash = hash(&description.hash().to_string());
        TypeInfo::new("action_msgs::msg::dds_::GoalStatusArray_", hash)
    }
}
