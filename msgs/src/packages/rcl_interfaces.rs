//! Package `rcl_interfaces`: logs and parameters, which every ROS node has. Definitions alone, for bags and hashes; the
//! Rust types are inside `wm_ros`, the only crate that speaks them.

/// Names and definitions of the messages, each with all that it names but those of other packages.
pub const MESSAGES: [(&str, &str); 11] = [
    (
        "rcl_interfaces/msg/FloatingPointRange",
        "float64 from_value\nfloat64 to_value\nfloat64 step\n",
    ),
    (
        "rcl_interfaces/msg/IntegerRange",
        "int64 from_value\nint64 to_value\nuint64 step\n",
    ),
    (
        "rcl_interfaces/msg/ListParametersResult",
        "string[] names\nstring[] prefixes\n",
    ),
    (
        "rcl_interfaces/msg/Log",
        "uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\nbuiltin_interfaces/Time stamp\n\
         uint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n",
    ),
    (
        "rcl_interfaces/msg/LoggerLevel",
        "uint8 LOG_LEVEL_UNKNOWN=0\nuint8 LOG_LEVEL_DEBUG=10\nuint8 LOG_LEVEL_INFO=20\nuint8 LOG_LEVEL_WARN=30\n\
         uint8 LOG_LEVEL_ERROR=40\nuint8 LOG_LEVEL_FATAL=50\nstring name\nuint32 level\n",
    ),
    (
        "rcl_interfaces/msg/Parameter",
        "string name\nParameterValue value\n",
    ),
    (
        "rcl_interfaces/msg/ParameterDescriptor",
        "string name\nuint8 type\nstring description\nstring additional_constraints\nbool read_only false\n\
         bool dynamic_typing false\nFloatingPointRange[<=1] floating_point_range\nIntegerRange[<=1] integer_range\n",
    ),
    (
        "rcl_interfaces/msg/ParameterEvent",
        "builtin_interfaces/Time stamp\nstring node\nParameter[] new_parameters\nParameter[] changed_parameters\n\
         Parameter[] deleted_parameters\n",
    ),
    (
        "rcl_interfaces/msg/ParameterValue",
        "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\nstring string_value\n\
         byte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\n\
         float64[] double_array_value\nstring[] string_array_value\n",
    ),
    (
        "rcl_interfaces/msg/SetLoggerLevelsResult",
        "bool successful\nstring reason\n",
    ),
    (
        "rcl_interfaces/msg/SetParametersResult",
        "bool successful\nstring reason\n",
    ),
];

/// Names and definitions of the services.
pub const SERVICES: [(&str, &str); 8] = [
    (
        "rcl_interfaces/srv/DescribeParameters",
        "string[] names\n---\nParameterDescriptor[] descriptors\n",
    ),
    (
        "rcl_interfaces/srv/GetLoggerLevels",
        "string[] names\n---\nLoggerLevel[] levels\n",
    ),
    (
        "rcl_interfaces/srv/GetParameterTypes",
        "string[] names\n---\nuint8[] types\n",
    ),
    (
        "rcl_interfaces/srv/GetParameters",
        "string[] names\n---\nParameterValue[] values\n",
    ),
    (
        "rcl_interfaces/srv/ListParameters",
        "uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth\n---\nListParametersResult result\n",
    ),
    (
        "rcl_interfaces/srv/SetLoggerLevels",
        "LoggerLevel[] levels\n---\nSetLoggerLevelsResult[] results\n",
    ),
    (
        "rcl_interfaces/srv/SetParameters",
        "Parameter[] parameters\n---\nSetParametersResult[] results\n",
    ),
    (
        "rcl_interfaces/srv/SetParametersAtomically",
        "Parameter[] parameters\n---\nSetParametersResult result\n",
    ),
];
