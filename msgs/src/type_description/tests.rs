use super::*;
use crate::{lifecycle_msgs, wm_msgs::action};
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

/// The numbers come from `type_description_interfaces/msg/FieldType`.
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
fn errors_name_the_fault() {
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
    let error = TypeDescription::action("pkg/action/A", "int32 x\n---\n", []).unwrap_err();
    assert!(error.to_string().contains("got 1"), "{error}");
    for name in ["pkg/action/A_Other", "A", "a/b/c/A"] {
        let error = TypeDescription::action(name, "---\n---\n", []).unwrap_err();
        assert!(
            error.to_string().contains("expected a type name"),
            "{error}"
        );
    }
}

#[test]
fn services_have_request_response_and_event() {
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

#[test]
fn actions_have_parts_two_services_and_a_message() {
    let description = TypeDescription::of_action::<action::Plan>().unwrap();
    let own =
        |part: &IndividualType| Some(part.name.strip_prefix("wm_msgs/action/Plan_")?.to_owned());
    let names: Vec<_> = description.referenced.iter().filter_map(own).collect();
    assert_eq!(
        names,
        [
            "Feedback",
            "FeedbackMessage",
            "GetResult",
            "GetResult_Event",
            "GetResult_Request",
            "GetResult_Response",
            "Goal",
            "Result",
            "SendGoal",
            "SendGoal_Event",
            "SendGoal_Request",
            "SendGoal_Response",
        ]
    );
}

#[test]
fn part_of_action_names_only_its_own_types() {
    let text = "int32 order\n---\nint32[] sequence\n---\nstd_msgs/Header header\n";
    let described = |name: &str, given: &[(&'static str, &'static str)]| {
        let described = TypeDescription::action(name, text, given.iter().copied());
        let described = described.unwrap();
        assert_eq!(described.described.name, name);
        let names = described.referenced.into_iter().map(|part| part.name);
        names.collect::<Vec<_>>()
    };
    assert_eq!(described("a_b/action/Fibonacci_Goal", &[]), [""; 0]);
    assert_eq!(
        described("a_b/action/Fibonacci_GetResult_Response", &[]),
        ["a_b/action/Fibonacci_Result"]
    );
    let header = [("std_msgs/Header", "string frame_id\n")];
    assert_eq!(
        described("a_b/action/Fibonacci_FeedbackMessage", &header),
        [
            "a_b/action/Fibonacci_Feedback",
            "std_msgs/msg/Header",
            "unique_identifier_msgs/msg/UUID"
        ]
    );
}

#[test]
fn circular_types_are_described() {
    let given = [("p/msg/B", "A a\n"), ("p/A", "B b\n")];
    let description = TypeDescription::message("p/A", "B b\n", given).unwrap();
    assert_eq!(description.referenced.len(), 2);
}

proptest! {
    /// Any text gives a description or an error, never a panic.
    #[test]
    fn any_text_gives_a_description_or_an_error(text in "([a-zA-Z0-9_/<=\\[\\]# \"-]{0,12}\n?|---\n){0,6}") {
        TypeDescription::message("p/msg/T", &text, []).ok();
        TypeDescription::service("p/srv/T", &text, []).ok();
        TypeDescription::action("p/action/T", &text, []).ok();
    }
}
