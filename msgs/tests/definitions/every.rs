//! The lists of all types of the crate.

/// Runs a generic check for every message type of the crate; what follows its name is passed on to each call.
macro_rules! every_message {
    ($check:ident $(, $argument:expr)*) => {
        every_message!(@ $check [$($argument),*]
            builtin_interfaces::Time builtin_interfaces::Duration std_msgs::Header std_msgs::String std_msgs::Bool
            std_msgs::Float32 std_msgs::Float64 std_msgs::MultiArrayDimension std_msgs::MultiArrayLayout
            std_msgs::Float64MultiArray std_msgs::ColorRGBA sensor_msgs::Image sensor_msgs::CompressedImage sensor_msgs::JointState
            geometry_msgs::Point geometry_msgs::Quaternion geometry_msgs::Pose geometry_msgs::PoseStamped
            geometry_msgs::Vector3 geometry_msgs::Twist geometry_msgs::TwistStamped diagnostic_msgs::KeyValue
            diagnostic_msgs::DiagnosticStatus diagnostic_msgs::DiagnosticArray rosgraph_msgs::Clock
            vision_msgs::VisionClass vision_msgs::LabelInfo
            geometry_msgs::PoseArray geometry_msgs::Transform geometry_msgs::TransformStamped
            sensor_msgs::RegionOfInterest sensor_msgs::CameraInfo tf2_msgs::TFMessage
            trajectory_msgs::JointTrajectoryPoint trajectory_msgs::JointTrajectory
            visualization_msgs::UVCoordinate visualization_msgs::MeshFile visualization_msgs::Marker
            visualization_msgs::MarkerArray
            lifecycle_msgs::State lifecycle_msgs::Transition lifecycle_msgs::TransitionDescription
            lifecycle_msgs::TransitionEvent wm_msgs::LatentSpace wm_msgs::Latent wm_msgs::Action wm_msgs::ActionChunk
            wm_msgs::Prediction wm_msgs::PredictionError wm_msgs::Plan wm_msgs::Timing wm_msgs::ActionCandidates
            wm_msgs::CandidateAssessment wm_msgs::Assessment wm_msgs::EnvObservation
            wm_msgs::ExecutorStatus wm_msgs::CameraState wm_msgs::Goal unique_identifier_msgs::UUID action_msgs::GoalInfo
            action_msgs::GoalStatus action_msgs::GoalStatusArray)
    };
    (@ $check:ident $arguments:tt $($package:ident :: $message:ident)*) => {
        $(every_message!(@call $check $arguments $package $message);)*
    };
    (@call $check:ident [$($argument:expr),*] $package:ident $message:ident) => {
        $check::<::wm_msgs::$package::$message>($($argument),*)
    };
}

/// Runs a generic check for every service type of the crate.
macro_rules! every_service {
    ($check:ident $(, $argument:expr)*) => {
        $check::<::wm_msgs::wm_msgs::Reset>($($argument),*);
        $check::<::wm_msgs::wm_msgs::EnvReset>($($argument),*);
        $check::<::wm_msgs::wm_msgs::EnvStep>($($argument),*);
        $check::<::wm_msgs::action_msgs::CancelGoal>($($argument),*);
        $check::<::wm_msgs::std_srvs::Trigger>($($argument),*);
        $check::<::wm_msgs::std_srvs::SetBool>($($argument),*);
        $check::<::wm_msgs::lifecycle_msgs::ChangeState>($($argument),*);
        $check::<::wm_msgs::lifecycle_msgs::GetState>($($argument),*);
        $check::<::wm_msgs::lifecycle_msgs::GetAvailableStates>($($argument),*);
        $check::<::wm_msgs::lifecycle_msgs::GetAvailableTransitions>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Pause>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Resume>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::TogglePaused>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::IsPaused>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::GetRate>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::SetRate>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::PlayNext>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Burst>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Seek>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Play>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Stop>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Snapshot>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::SplitBagfile>($($argument),*);
        $check::<::wm_msgs::rosbag2_interfaces::Record>($($argument),*);
    };
}

/// Runs a generic check for every action type of the crate.
macro_rules! every_action {
    ($check:ident $(, $argument:expr)*) => {
        $check::<::wm_msgs::wm_msgs::action::Plan>($($argument),*);
    };
}
