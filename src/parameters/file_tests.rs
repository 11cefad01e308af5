use proptest::prelude::*;

use super::*;

fn error(text: &str) -> String {
    StartUpList::from_toml(text, "list.toml")
        .unwrap_err()
        .to_string()
}

fn entry(rest: &str) -> String {
    format!("drive = \"left\"\n\n[[write]]\nobject = \"2345h:01\"\n{rest}")
}

#[test]
fn a_list_has_its_lines_in_order_with_types_axes_and_transitions() {
    let text = r#"
        drive = "gantry left"
        [[write]]
        object = "quick stop deceleration"
        axis = 2
        value = 1_000_000
        comment = "with full load"
        verify = true
        [[write]]
        object = "2345h:0A"
        type = "bytes"
        value = [1, 0xFF]
        transition = "SAFEOP-OP"
    "#;
    let list = StartUpList::from_toml(text, "list.toml").unwrap();
    let mut first = StartUpWrite::new(obj::QUICK_STOP_DECELERATION.axis(2), 1_000_000)
        .comment("with full load")
        .verified();
    first.line = Some(4);
    let mut second =
        StartUpWrite::to(ObjectAddress::new(0x2345, 10), vec![1, 0xFF]).at(Transition::SafeOpToOp);
    second.line = Some(10);
    assert_eq!(list.writes, [first, second]);
}

#[test]
fn every_type_has_its_ends_and_nothing_beyond_them() {
    for (kind, good, bad) in [
        ("u8", ["0", "255"], ["-1", "256"]),
        ("i8", ["-128", "127"], ["-129", "128"]),
        ("u16", ["0", "0xFFFF"], ["-1", "65536"]),
        ("i16", ["-32768", "32767"], ["-32769", "32768"]),
        ("u32", ["0", "4294967295"], ["-1", "4294967296"]),
        (
            "i32",
            ["-2147483648", "2147483647"],
            ["-2147483649", "2147483648"],
        ),
        (
            "u64",
            ["0", "18446744073709551615"],
            ["-1", "18446744073709551616"],
        ),
        (
            "i64",
            ["-9223372036854775808", "9223372036854775807"],
            ["9223372036854775808", "1.5"],
        ),
        ("f32", ["1.5", "-3"], ["1e300", "\"1\""]),
        ("string", ["\"ab\"", "''"], ["1", "[1]"]),
        ("bytes", ["[]", "[0, 255]"], ["\"ab\"", "1"]),
    ] {
        for value in good {
            let text = entry(&format!("type = \"{kind}\"\nvalue = {value}"));
            let list = StartUpList::from_toml(&text, "list.toml").unwrap();
            assert_eq!(list.writes[0].value.value_type().to_string(), kind);
        }
        for value in bad {
            let got = error(&entry(&format!("type = \"{kind}\"\nvalue = {value}")));
            let place = "list.toml:6: drive \"left\": object \"2345h:01\": expected ";
            assert!(got.starts_with(place), "{kind} {value}: {got}");
        }
    }
}

#[test]
fn every_mistake_is_named_with_its_line() {
    for (rest, line, part) in [
        ("value = 1", 4, "its type is not known"),
        ("type = \"u128\"\nvalue = 1", 5, "`u128` is no type"),
        (
            "type = \"u8\"\naxis = 9\nvalue = 1",
            6,
            "axis 9 is not 1 to 8",
        ),
        (
            "type = \"u8\"\nvalue = 1\ntransition = \"INIT-PREOP\"",
            7,
            "PREOP-SAFEOP or SAFEOP-OP",
        ),
        ("type = \"u8\"\nvalues = 1", 6, "unknown field `values`"),
        ("type = \"u8\"", 3, "missing field `value`"),
        (
            "type = \"u8\"\nvalue = true",
            6,
            "a number, a string or a list of bytes",
        ),
        ("type = \"bytes\"\nvalue = [256]", 6, "256 is no byte"),
        ("type = \"u8\"\nvalue = ", 6, ""),
        (
            "type = \"u8\"\nvalue = 1\ntype = \"u8\"",
            7,
            "duplicate key",
        ),
    ] {
        let got = error(&entry(rest));
        assert!(
            got.starts_with(&format!("list.toml:{line}: ")),
            "{rest}: {got}"
        );
        assert!(got.contains(part), "{rest}: {got}");
    }
    for object in [
        "6081",
        "6081h:",
        "6081h:100",
        "60811h:00",
        "h",
        "6081h:00:00",
        "6081h:+1",
        "",
    ] {
        let got = error(&format!(
            "[[write]]\nobject = \"{object}\"\ntype = \"u8\"\nvalue = 1"
        ));
        assert!(
            got.contains("neither index and subindex"),
            "{object}: {got}"
        );
    }
}

#[test]
fn a_list_never_writes_a_controlword() {
    for object in [
        "object = \"controlword\"",
        "object = \"6840h\"",
        "object = \"controlword\"\naxis = 8",
    ] {
        let got = error(&format!("[[write]]\n{object}\nvalue = 15"));
        assert!(got.starts_with("list.toml:2: "), "{got}");
        assert!(got.contains("enable the axis by its handle"), "{got}");
    }
}

#[test]
fn a_file_that_is_missing_or_too_long_is_named() {
    let error = StartUpList::load("no/such/list.toml").unwrap_err();
    assert!(matches!(error.kind, FileFault::Io(_)), "{error}");
    assert!(error.to_string().starts_with("no/such/list.toml: "));
    let error = StartUpList::from_toml(&"#".repeat(LONGEST_FILE + 1), "l").unwrap_err();
    assert_eq!(error.kind, FileFault::TooLong);
}

proptest! {
    #[test]
    fn nothing_makes_a_list_panic(text in "\\PC{0,200}") {
        let _ = StartUpList::from_toml(&text, "l");
    }

    #[test]
    fn a_damaged_list_is_read_or_refused_with_a_line(
        cut in 0_usize..400, at in 0_usize..400, new in prop::sample::select(b"\"=[]{}#,.-09xh\n\t \\".to_vec()),
    ) {
        let whole = entry("type = \"u16\"\nvalue = 7\ncomment = \"c\"\n[[write]]\nobject = \"position window\"\nvalue = 0x10\nverify = true\n");
        let mut bytes = whole.into_bytes();
        if let Some(byte) = bytes.get_mut(at) {
            *byte = new;
        }
        bytes.truncate(cut.max(1));
        let text = String::from_utf8(bytes).unwrap();
        if let Err(error) = StartUpList::from_toml(&text, "l") {
            let lines = text.split('\n').count();
            let line = error.line.expect("a line");
            prop_assert!((1..=lines).contains(&line), "{} of {}: {}", line, lines, error);
        }
    }
}
