use super::*;
use crate::lifecycle_msgs;
use proptest::prelude::*;

fn types(text: &str) -> Vec<(u8, u64, u64, Option<String>)> {
    let parsed = definition::parse("pkg/msg/Type", text).unwrap();
    let numbers = |field: Field| {
        let FieldType {
            type_id,
            capacity,
            string_capacity,
            nested,
        } = field.field_type;
        (type_id, capacity, string_capacity, nested)
    };
    parsed.fields.into_iter().map(numbers).collect()
}

/// The numbers are those of `type_description_interfaces/msg/FieldType`.
#[test]
fn every_form_of_a_field_has_its_number() {
    let text = "# Comment\nuint8 LIMIT=3\nstring<=5 NAME = \"a # b\"\n\nbool b true # on\nbyte[] octets\nchar[16] gid\n\
                string<=9 short\nwstring<=9[<=3] words \"=\"\nfloat64[] x [1.0, 2.0]\nOther[<=2] some\na/Thing[3] three\n\
                a/msg/Thing one";
    let nested = |name: &str| Some(name.to_owned());
    assert_eq!(
        types(text),
        [
            (15, 0, 0, None),
            (160, 0, 0, None),
            (51, 16, 0, None),
            (21, 0, 9, None),
            (118, 3, 9, None),
            (155, 0, 0, None),
            (97, 2, 0, nested("pkg/msg/Other")),
            (49, 3, 0, nested("a/msg/Thing")),
            (1, 0, 0, nested("a/msg/Thing")),
        ]
    );
    assert_eq!(types("# nothing\nuint8 X=1\n"), [(3, 0, 0, None)]);
}

#[test]
fn what_is_wrong_is_named() {
    let error = |text: &str| {
        TypeDescription::message("pkg/msg/Type", text, [])
            .unwrap_err()
            .to_string()
    };
    assert!(error("int32").contains("`int32`"));
    assert!(error("int32 2x").contains("`int32 2x`"));
    assert!(error("int128 x").contains("`int128`"));
    assert!(error("int32[<=x] y").contains("`int32[<=x]`"));
    assert!(error("Other x").contains("pkg/msg/Other, which pkg/msg/Type names"));
    for name in ["Type", "a/b/c/d", "a b/msg/T", "pkg/act/T"] {
        let error = TypeDescription::message(name, "", []).unwrap_err();
        assert_eq!(error, DescriptionError::Name(name.to_owned()));
    }
    let error = TypeDescription::service("pkg/srv/S", "int32 x\n", []).unwrap_err();
    assert!(error.to_string().contains("---"), "{error}");
}

#[test]
fn a_service_is_its_request_its_response_and_the_event_of_both() {
    let description = TypeDescription::of_service::<lifecycle_msgs::GetState>().unwrap();
    let names: Vec<_> = description
        .referenced
        .iter()
        .map(|part| part.name.as_str())
        .collect();
    assert_eq!(
        names,
        [
            "builtin_interfaces/msg/Time",
            "lifecycle_msgs/msg/State",
            "lifecycle_msgs/srv/GetState_Event",
            "lifecycle_msgs/srv/GetState_Request",
            "lifecycle_msgs/srv/GetState_Response",
            "service_msgs/msg/ServiceEventInfo",
        ]
    );
}

/// Names that circle, as no ROS type's do, come to an end.
#[test]
fn types_that_name_each_other_come_to_an_end() {
    let given = [("p/msg/B", "A a\n"), ("p/A", "B b\n")];
    let description = TypeDescription::message("p/A", "B b\n", given).unwrap();
    assert_eq!(description.referenced.len(), 2);
}

proptest! {
    /// A description or an error, never a panic, whatever the text.
    #[test]
    fn any_text_is_answered(text in "([a-zA-Z0-9_/<=\\[\\]# \"-]{0,12}\n?){0,6}") {
        TypeDescription::message("p/msg/T", &text, []).ok();
        TypeDescription::service("p/srv/T", &text, []).ok();
    }
}
