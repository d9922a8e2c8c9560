//! Finds the fields of a type through its `Deserialize`: a deserializer that records each request, and returns a plain
//! value. Sequences get one element, so that the type of their elements is recorded too.

use serde::de::{
    self, DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor,
    value::Error as ValueError,
};

/// The structure of a type, in the names of `.msg` files.
#[derive(Debug, PartialEq, Eq)]
pub enum Shape {
    Primitive(String),
    Bytes,
    Sequence(Box<Shape>),
    Array(Box<Shape>, usize),
    Struct {
        name: String,
        fields: Vec<(String, Shape)>,
    },
}

pub fn describe<T: DeserializeOwned>() -> Shape {
    let mut shape = None;
    T::deserialize(Recorder(&mut shape)).unwrap();
    shape.unwrap()
}

struct Recorder<'a>(&'a mut Option<Shape>);

macro_rules! primitive {
    ($($deserialize:ident $visit:ident $name:literal $value:expr;)*) => {
        $(fn $deserialize<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
            *self.0 = Some(Shape::Primitive($name.to_owned()));
            visitor.$visit($value)
        })*
    };
}

macro_rules! bytes {
    ($($deserialize:ident)*) => {
        $(fn $deserialize<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
            *self.0 = Some(Shape::Bytes);
            visitor.visit_bytes(&[])
        })*
    };
}

impl<'de> Deserializer<'de> for Recorder<'_> {
    type Error = ValueError;

    primitive! {
        deserialize_bool visit_bool "bool" false;
        deserialize_i8 visit_i8 "int8" 0;
        deserialize_u8 visit_u8 "uint8" 0;
        deserialize_i16 visit_i16 "int16" 0;
        deserialize_u16 visit_u16 "uint16" 0;
        deserialize_i32 visit_i32 "int32" 0;
        deserialize_u32 visit_u32 "uint32" 0;
        deserialize_i64 visit_i64 "int64" 0;
        deserialize_u64 visit_u64 "uint64" 0;
        deserialize_f32 visit_f32 "float32" 0.0;
        deserialize_f64 visit_f64 "float64" 0.0;
        deserialize_str visit_str "string" "";
        deserialize_string visit_str "string" "";
    }

    bytes! { deserialize_bytes deserialize_byte_buf }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        let mut element = Parts {
            names: &[""],
            shapes: Vec::new(),
        };
        let value = visitor.visit_seq(&mut element)?;
        let (_, shape) = element
            .shapes
            .pop()
            .ok_or_else(|| de::Error::custom("a sequence took no element"))?;
        *self.0 = Some(Shape::Sequence(Box::new(shape)));
        Ok(value)
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        let mut elements = Parts {
            names: &ELEMENTS[..len],
            shapes: Vec::new(),
        };
        let value = visitor.visit_seq(&mut elements)?;
        let (_, shape) = elements
            .shapes
            .pop()
            .ok_or_else(|| de::Error::custom("an array took no element"))?;
        *self.0 = Some(Shape::Array(Box::new(shape), len));
        Ok(value)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        let mut parts = Parts {
            names: fields,
            shapes: Vec::new(),
        };
        let value = visitor.visit_seq(&mut parts)?;
        *self.0 = Some(Shape::Struct {
            name: name.to_owned(),
            fields: parts.shapes,
        });
        Ok(value)
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, ValueError> {
        Err(de::Error::custom("a type that ROS does not have"))
    }

    serde::forward_to_deserialize_any! {
        i128 u128 char option unit unit_struct newtype_struct tuple_struct map enum identifier ignored_any
    }
}

/// As many as the longest array has elements.
const ELEMENTS: [&str; 16] = [""; 16];

/// Names of all parts, and the shapes of the parts so far.
struct Parts {
    names: &'static [&'static str],
    shapes: Vec<(String, Shape)>,
}

impl<'de> SeqAccess<'de> for &mut Parts {
    type Error = ValueError;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, ValueError> {
        let Some(name) = self.names.get(self.shapes.len()) else {
            return Ok(None);
        };
        let mut shape = None;
        let value = seed.deserialize(Recorder(&mut shape))?;
        let shape = shape.ok_or_else(|| de::Error::custom("a field requested nothing"))?;
        self.shapes.push(((*name).to_owned(), shape));
        Ok(Some(value))
    }
}
