//! Package `visualization_msgs`: shapes that viewers draw into the scene.

use super::{
    builtin_interfaces::Duration,
    geometry_msgs::{Point, Pose, Vector3},
    sensor_msgs::CompressedImage,
    std_msgs::{ColorRGBA, Header},
};
use serde::{Deserialize, Serialize};

/// A place in a texture, as parts of its width and height.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UVCoordinate {
    /// Along the width, 0 to 1.
    pub u: f32,
    /// Along the height, 0 to 1.
    pub v: f32,
}

/// A mesh within a message.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshFile {
    /// Its name, whose ending says what it is.
    pub filename: String,
    /// The file's bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

/// A shape. Another one with its `ns` and `id` takes its place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// `stamp`: when the shape was there; `frame_id`: the frame of `pose`.
    pub header: Header,
    /// What it belongs to: viewers show and hide these by name.
    pub ns: String,
    /// Which one of them.
    pub id: i32,
    /// What it is, for example [`CUBE`](Self::CUBE).
    pub r#type: i32,
    /// [`ADD`](Self::ADD), or what is to become of an earlier one.
    pub action: i32,
    /// Where its middle is; of lines, the frame of the points.
    pub pose: Pose,
    /// How large it is \[m\]; of lines, `x` is their width.
    pub scale: Vector3,
    /// Its colour, where `colors` has none.
    pub color: ColorRGBA,
    /// When it vanishes; 0: never.
    pub lifetime: Duration,
    /// Whether it moves with the frame.
    pub frame_locked: bool,
    /// Of lines and lists.
    pub points: Vec<Point>,
    /// One a point, or none.
    pub colors: Vec<ColorRGBA>,
    /// Where the texture is.
    pub texture_resource: String,
    /// The texture itself.
    pub texture: CompressedImage,
    /// One a point, or none.
    pub uv_coordinates: Vec<UVCoordinate>,
    /// Of texts.
    pub text: String,
    /// Where the mesh is.
    pub mesh_resource: String,
    /// The mesh itself.
    pub mesh_file: MeshFile,
    /// Whether the mesh has colours of its own.
    pub mesh_use_embedded_materials: bool,
}

impl Marker {
    /// A box.
    pub const CUBE: i32 = 1;
    /// An ellipsoid.
    pub const SPHERE: i32 = 2;
    /// Lines from each point to the next.
    pub const LINE_STRIP: i32 = 4;
    /// Lines from each second point to the next.
    pub const LINE_LIST: i32 = 5;
    /// A ball at each point.
    pub const SPHERE_LIST: i32 = 7;
    /// Draw it, in the place of an earlier one.
    pub const ADD: i32 = 0;
    /// Remove it.
    pub const DELETE: i32 = 2;
}

/// Shapes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MarkerArray {
    /// In any order.
    pub markers: Vec<Marker>,
}

message!(
    UVCoordinate,
    "visualization_msgs",
    "float32 u\nfloat32 v\n",
    []
);
message!(
    MeshFile,
    "visualization_msgs",
    "string filename\nuint8[] data\n",
    []
);
message!(
    Marker,
    "visualization_msgs",
    "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\nint32 LINE_LIST=5\n\
     int32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\nint32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\n\
     int32 TRIANGLE_LIST=11\nint32 ARROW_STRIP=12\nint32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\n\
     std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n\
     geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\nbool frame_locked\n\
     geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n\
     sensor_msgs/CompressedImage texture\nUVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n\
     MeshFile mesh_file\nbool mesh_use_embedded_materials\n",
    [
        Header,
        Pose,
        Vector3,
        ColorRGBA,
        Duration,
        Point,
        CompressedImage,
        UVCoordinate,
        MeshFile
    ]
);
message!(
    MarkerArray,
    "visualization_msgs",
    "Marker[] markers\n",
    [Marker]
);
