use serde_json::Value;
use sha2::{Digest as _, Sha256};

/// SHA-256 of values, independent of the order of object keys, which a serde_json feature of any crate may change.
pub(crate) fn question_key(values: &[&Value]) -> String {
    let mut canonical = String::new();
    for value in values {
        write(&mut canonical, value);
        canonical.push('\n');
    }
    format!("{:x}", Sha256::digest(canonical))
}

fn write(out: &mut String, value: &Value) {
    match value {
        Value::Array(values) => {
            out.push('[');
            for value in values {
                write(out, value);
                out.push(',');
            }
            out.push(']');
        }
        Value::Object(object) => {
            let mut fields: Vec<_> = object.iter().collect();
            fields.sort_unstable_by_key(|(name, _)| *name);
            out.push('{');
            for (name, value) in fields {
                write(out, &Value::String(name.clone()));
                out.push(':');
                write(out, value);
                out.push(',');
            }
            out.push('}');
        }
        // JSON has no other characters outside quotes.
        scalar => out.push_str(&scalar.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn key_depends_on_values_but_not_on_key_order() {
        let key = |value: Value| question_key(&[&value]);
        assert_eq!(
            key(json!({"a": 1, "b": [2, null]})),
            key(json!({"b": [2, null], "a": 1}))
        );
        let different = [
            json!({"a": 1}),
            json!({"a": 1.0}),
            json!({"a": "1"}),
            json!({"a": [1]}),
            json!({"a": [[], 1]}),
            json!({"a\":1,\"b": 1}),
            json!([1]),
            json!(null),
        ];
        let keys: std::collections::BTreeSet<_> = different.into_iter().map(key).collect();
        assert_eq!(keys.len(), 8);
        assert_ne!(
            question_key(&[&json!(1), &json!(2)]),
            question_key(&[&json!(2), &json!(1)])
        );
    }

    #[test]
    fn key_is_stable() {
        // A changed hash would make records unusable.
        assert_eq!(
            question_key(&[&json!({"model": "m", "seed": 0}), &json!(1)]),
            "f047ed92794132823bdfe76bc10dffdb4224e6b620b7d88ba4e1e378b3783e49"
        );
    }
}
