use super::*;
use crate::coe::Abort;
use proptest::prelude::*;

const GENERIC: &str = include_str!("../../esi/generic.xml");

fn file(device: &str) -> String {
    format!(
        "<EtherCATInfo>\n<Vendor><Id>1</Id></Vendor>\n<Descriptions><Devices><Device><Type ProductCode=\"2\">D</Type>\n{device}\n</Device></Devices></Descriptions></EtherCATInfo>"
    )
}

const MAILBOX: &str = "<Sm StartAddress=\"#x1000\" DefaultSize=\"128\" ControlByte=\"#x26\">MBoxOut</Sm>\
    <Sm StartAddress=\"#x1100\" DefaultSize=\"128\" ControlByte=\"#x22\">MBoxIn</Sm><Mailbox><CoE/></Mailbox>";

#[test]
fn a_device_is_what_its_file_says() {
    let mut device = EsiDrive::from_bytes("generic.xml", GENERIC.as_bytes())
        .unwrap()
        .build();
    let description = device.description();
    assert_eq!(
        (description.name.as_str(), description.order.as_str()),
        ("CiA 402 servo drive", "CiA402")
    );
    assert_eq!(
        (description.identity.product, description.identity.revision),
        (0x4453_0402, 1)
    );
    assert_eq!(description.mailbox.unwrap().coe_details, 0x2F);
    assert_eq!(description.fmmu_usage, [1, 2, 3]);
    let lengths: Vec<u16> = description
        .sync_managers
        .iter()
        .map(|sm| sm.length)
        .collect();
    assert_eq!(lengths, [256, 256, 19, 11]);
    assert_eq!(description.pdos.len(), 8);
    assert_eq!(description.ds402_channels, 1);
    assert_eq!(device.axes().len(), 1);
    let object = device
        .dictionary()
        .into_iter()
        .find(|object| object.index == 0x1C12)
        .unwrap();
    assert_eq!(object.last, 4);
}

#[test]
fn objects_have_their_types_defaults_and_access() {
    let text = file(&format!(
        "{MAILBOX}<Profile><Dictionary><DataTypes>\
         <DataType><Name>A</Name><BaseType>UINT</BaseType><BitSize>32</BitSize><ArrayInfo><LBound>1</LBound><Elements>2</Elements></ArrayInfo></DataType>\
         <DataType><Name>D</Name><SubItem><SubIdx>0</SubIdx><Type>USINT</Type><BitSize>8</BitSize></SubItem>\
         <SubItem><Type>A</Type><BitSize>32</BitSize><Flags><Access>rw</Access></Flags></SubItem></DataType></DataTypes><Objects>\
         <Object><Index>#x2000</Index><Name>Gain</Name><Type>DINT</Type><BitSize>32</BitSize><Info><DefaultValue>-2</DefaultValue></Info><Flags><Access>rw</Access><PdoMapping>R</PdoMapping></Flags></Object>\
         <Object><Index>#x2001</Index><Name>List</Name><Type>D</Type><Info><SubItem><Info><DefaultData>02</DefaultData></Info></SubItem><SubItem><Info><DefaultData>3412</DefaultData></Info></SubItem></Info></Object>\
         <Object><Index>#x2002</Index><Name>Text</Name><Type>STRING(8)</Type><BitSize>64</BitSize><Info><DefaultString>abc</DefaultString></Info></Object>\
         <Object><Index>#x6040</Index><Type>UINT</Type><BitSize>16</BitSize><Info><DefaultData>0F00</DefaultData></Info></Object>\
         <Object><Index>#x6081</Index><Type>UDINT</Type><BitSize>32</BitSize><Info><DefaultData>39300000</DefaultData></Info></Object>\
         <Object><Index>#x6FFE</Index><Type>USINT</Type><BitSize>8</BitSize><Info><DefaultData>07</DefaultData></Info></Object>\
         </Objects></Dictionary></Profile>"
    ));
    let mut device = EsiDrive::from_bytes("d.xml", text.as_bytes())
        .unwrap()
        .build();
    let axis = device.axis(0).unwrap();
    assert_eq!(axis.get(0x6081, 0), Some(12_345));
    assert_eq!(axis.get(0x6040, 0), Some(0), "no file switches an axis on");
    let objects = device.dictionary();
    let entry = |index: u16, subindex: u8| {
        let object = objects.iter().find(|object| object.index == index).unwrap();
        let entry = object
            .entries
            .iter()
            .find(|entry| entry.subindex == subindex);
        (object.code, entry.unwrap().clone())
    };
    let (code, gain) = entry(0x2000, 0);
    assert_eq!(
        (code, gain.data_type, gain.bits, gain.access),
        (7, 4, 32, 0x7F)
    );
    assert_eq!(gain.default, Some(vec![0xFE, 0xFF, 0xFF, 0xFF]));
    let (code, first) = entry(0x2001, 1);
    assert_eq!(
        (code, first.data_type, first.default),
        (8, 6, Some(vec![0x34, 0x12]))
    );
    assert_eq!(entry(0x2001, 2).1.default, Some(vec![0, 0]));
    assert_eq!(
        (entry(0x2002, 0).1.data_type, entry(0x2002, 0).1.bits),
        (9, 64)
    );
    assert_eq!(entry(0x6FFE, 0).1.data_type, 5);
}

#[test]
fn values_at_power_up_are_taken_as_devices_do_and_what_is_cut_is_said() {
    let object = |index: u16, kind: &str, bits: u32, value: &str| {
        format!(
            "<Object><Index>0x{index:X}</Index><Type>{kind}</Type><BitSize>{bits}</BitSize>\n<Info>{value}</Info></Object>"
        )
    };
    let data = |digits: &str| format!("<DefaultData>{digits}</DefaultData>");
    let number = |number: &str| format!("<DefaultValue>{number}</DefaultValue>");
    let objects = [
        object(0x6502, "UINT", 16, &data("2100")),
        object(0x2000, "UDINT", 32, &data("34")),
        object(0x2001, "UINT", 16, &data("341256")),
        object(0x2002, "USINT", 8, &number("0x1FF")),
        object(0x2003, "DINT", 32, &number("-2")),
        object(0x2004, "REAL", 32, &number("1.5")),
        object(0x2005, "ARRAY [0..511] OF BYTE", 4096, &data("0102")),
        object(0x2006, "OCTET_STRING(512)", 4096, &data("0102")),
        object(
            0x2007,
            "STRING(2)",
            16,
            "<DefaultString>abc</DefaultString>",
        ),
        object(0x6040, "UINT", 16, ""),
    ];
    let text = file(&format!(
        "{MAILBOX}<Profile><Dictionary><Objects>{}</Objects></Dictionary></Profile>",
        objects.concat()
    ));
    let drive = EsiDrive::from_bytes("d.xml", text.as_bytes()).unwrap();
    assert_eq!(
        drive.warnings(),
        [
            "d.xml:7: \"341256\" is no value of 2 bytes: its beginning is taken",
            "d.xml:8: \"0x1FF\" is no value of 1 bytes: its beginning is taken",
            "d.xml:10: \"1.5\" is no value of 4 bytes: 0 is taken",
            "d.xml:13: \"abc\" is no value of 2 bytes: its beginning is taken",
        ]
    );
    let mut device = drive.build();
    let mut array = vec![0; 512];
    array[..2].copy_from_slice(&[1, 2]);
    for (index, expected) in [
        (0x6502, vec![0x21, 0, 0, 0]),
        (0x2000, vec![0x34, 0, 0, 0]),
        (0x2001, vec![0x34, 0x12]),
        (0x2002, vec![0xFF]),
        (0x2003, vec![0xFE, 0xFF, 0xFF, 0xFF]),
        (0x2004, vec![0; 4]),
        (0x2005, array),
        (0x2006, vec![1, 2]),
        (0x2007, b"ab".to_vec()),
    ] {
        assert_eq!(device.read_object(index, 0), Ok(expected), "{index:04X}h");
    }
}

#[test]
fn sync_managers_without_a_name_are_told_by_their_number() {
    let named = "<Sm>MBoxOut</Sm><Sm>MBoxIn</Sm><Sm>outputs</Sm><Sm>Inputs</Sm>";
    let uses = |text: &str| {
        let drive = EsiDrive::from_bytes("d.xml", file(text).as_bytes()).unwrap();
        let managers = drive.description.sync_managers.into_iter();
        managers.map(|one| one.purpose).collect::<Vec<_>>()
    };
    assert_eq!(
        uses("<Sm>0</Sm><Sm>1</Sm><Sm>2</Sm><Sm>3</Sm>"),
        uses(named)
    );
    assert_eq!(uses("<Sm/><Sm/><Sm/><Sm/>"), uses(named));
}

#[test]
fn errors_name_file_and_line() {
    for (text, expected) in [
        (
            file("<RxPdo><Index>#x16G0</Index></RxPdo>"),
            "d.xml:4: \"#x16G0\" is no number of 0 to 65535",
        ),
        (file("<TxPdo/>"), "d.xml:4: the element Index is missing"),
        (
            file("<Sm>Other</Sm>"),
            "d.xml:4: a sync manager for \"Other\" is not known",
        ),
        (
            file(&format!(
                "{MAILBOX}<Profile><Dictionary><Objects><Object><Index>1</Index><BitSize>16</BitSize>\n<Info><DefaultData>12345</DefaultData></Info></Object></Objects></Dictionary></Profile>"
            )),
            "d.xml:5: \"12345\" is no value",
        ),
        (
            file(&format!(
                "{MAILBOX}<Profile><Dictionary><Objects><Object><Index>1</Index><BitSize>4294967295</BitSize></Object></Objects></Dictionary></Profile>"
            )),
            "d.xml:4: a value of 4294967295 bits is longer than any here",
        ),
        (
            "<Html/>".to_owned(),
            "d.xml:1: expected EtherCATInfo as the outermost element",
        ),
    ] {
        let error = EsiDrive::from_bytes("d.xml", text.as_bytes()).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
    let broken =
        EsiDrive::from_bytes("d.xml", b"<EtherCATInfo>\n<Vendor>\n</EtherCATInfo>").unwrap_err();
    assert_eq!(broken.line, Some(3));
    let absent = EsiDrive::load("no/such.xml").unwrap_err().to_string();
    assert!(absent.starts_with("no/such.xml: "), "{absent}");
}

#[test]
fn an_element_with_very_many_attributes_is_refused_at_its_line() {
    let many: String = (0..100_000)
        .map(|number| format!(" a{number}='1'"))
        .collect();
    let text = format!("<EtherCATInfo>\n<Vendor{many}/>\n</EtherCATInfo>");
    let error = EsiDrive::from_bytes("d.xml", text.as_bytes()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "d.xml:2: an element with more than 200 attributes"
    );
}

#[test]
fn a_short_file_does_not_unfold_into_a_long_dictionary() {
    let types = "<DataType><Name>A</Name><BaseType>UINT</BaseType><ArrayInfo><Elements>255</Elements></ArrayInfo></DataType>\
        <DataType><Name>D</Name><SubItem><Type>A</Type></SubItem></DataType>";
    let objects = "<Object><Index>1</Index><Type>D</Type></Object>".repeat(300);
    let text = file(&format!(
        "{MAILBOX}<Profile><Dictionary><DataTypes>{types}</DataTypes><Objects>{objects}</Objects></Dictionary></Profile>"
    ));
    let error = EsiDrive::from_bytes("d.xml", text.as_bytes()).unwrap_err();
    assert!(error.reason.contains("65536 entries"), "{error}");
}

/// Where the numbers of a file are: all of an element or an attribute.
fn numbers(text: &str) -> Vec<core::ops::Range<usize>> {
    let mut found = Vec::new();
    for (start, _) in text.match_indices(['>', '"']) {
        let start = start + 1;
        let length = text[start..].find(['<', '"']).unwrap_or(0);
        let number = &text[start..start + length];
        let digits = number.strip_prefix("#x").unwrap_or(number);
        if !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            found.push(start..start + length);
        }
    }
    found
}

/// Where the elements of a file are, each with all that is in it.
fn elements(text: &str) -> Vec<core::ops::Range<usize>> {
    let document = roxmltree::Document::parse(text).unwrap();
    let elements = document.descendants().filter(roxmltree::Node::is_element);
    elements.map(|element| element.range()).collect()
}

/// Takes a device through frames and cycles on its way to OP, whatever it says to that.
fn lives(drive: EsiDrive) {
    let mut device = drive.build();
    let _ = device.dictionary();
    let mut segment = crate::Segment::new().with(device);
    let mut now = Duration::ZERO;
    // BWR of the AL control, BRD of what is there, LRW of 64 bytes from 0 on (ETG.1000.4).
    let datagram = |command: u8, address: [u8; 4], data: &[u8]| {
        let mut frame = vec![0xFF; 12];
        frame.extend([0x88, 0xA4, data.len() as u8 + 12, 0x10, command, 0]);
        frame.extend(address);
        frame.extend([data.len() as u8, 0, 0, 0]);
        frame.extend(data);
        frame.extend([0, 0]);
        frame
    };
    for state in [0x11, 0x12, 0x14, 0x18, 0x11] {
        for mut frame in [
            datagram(8, [0, 0, 0x20, 0x01], &[state, 0]),
            datagram(7, [0, 0, 0, 0x08], &[0; 64]),
            datagram(8, [0, 0, 0x02, 0x05], &[0, 1, 0x40, 0, 0, 0]),
            datagram(12, [0; 4], &[0; 64]),
        ] {
            segment.process(&mut frame, now);
            now += Duration::from_millis(1);
        }
    }
}

#[test]
fn a_file_with_any_number_far_too_large_or_any_element_missing_makes_a_device_that_lives_or_is_refused_with_its_line()
 {
    let extremes = [
        "0",
        "1",
        "255",
        "65535",
        "65536",
        "2147483647",
        "4294967295",
        "18446744073709551615",
        "99999999999999999999999999",
        "-1",
        "#x",
        "#xFFFFFFFF",
        "#xFFFFFFFFFFFFFFFFF",
        "",
    ];
    let numbers = numbers(GENERIC).into_iter();
    let numbers = numbers.flat_map(|place| extremes.map(|extreme| (place.clone(), extreme)));
    let missing = elements(GENERIC).into_iter().map(|place| (place, ""));
    let (mut made, mut refused) = (0, 0);
    for (place, put) in numbers.chain(missing) {
        let text = [&GENERIC[..place.start], put, &GENERIC[place.end..]].concat();
        match EsiDrive::from_bytes("changed.xml", text.as_bytes()) {
            Ok(drive) => {
                made += 1;
                // As many as are not alike; the rest is the same file in other words.
                if made % 7 == 0 {
                    lives(drive);
                }
            }
            Err(error) => {
                refused += 1;
                let is_whole = place == (0..GENERIC.len()) || text.is_empty();
                assert!(
                    error.line.is_some() || is_whole || text.len() < 100,
                    "{place:?} {put}: {error}"
                );
            }
        }
    }
    assert!(
        made > 1_000 && refused > 1_000,
        "{made} made, {refused} refused"
    );
}

proptest! {
    #[test]
    fn a_file_with_anything_put_anywhere_makes_a_device_or_is_refused(
        at in 0usize..20_000, cut in 0usize..40, put in "[<>/#x&;=\"a-zA-Z0-9 ]{0,12}",
    ) {
        let start = at % GENERIC.len();
        let end = (start + cut).min(GENERIC.len());
        let text = [&GENERIC.as_bytes()[..start], put.as_bytes(), &GENERIC.as_bytes()[end..]].concat();
        if let Ok(drive) = EsiDrive::from_bytes("changed", &text) {
            let _ = drive.build().dictionary();
        }
    }
}

/// A drive with an axis in a module for each of its two slots, and values at power-up that no drive here has otherwise.
const TWO_AXES: &str = include_str!("../../esi/two_axes.xml");

#[test]
fn the_axes_of_a_modular_drive_are_in_the_modules_of_its_slots() {
    let device = EsiDrive::from_bytes("two_axes.xml", TWO_AXES.as_bytes())
        .unwrap()
        .build();
    assert_eq!(device.axes().len(), 2);
    let pdos: Vec<_> = device
        .description()
        .pdos
        .iter()
        .map(|pdo| (pdo.index, pdo.entries[0].index))
        .collect();
    assert_eq!(
        pdos,
        [
            (0x1600, 0x6040),
            (0x1610, 0x6840),
            (0x1A00, 0x6041),
            (0x1A10, 0x6841)
        ]
    );
    assert_eq!(device.axis(1).unwrap().get(0x6081, 0), Some(54_321));
}

#[test]
fn a_module_that_is_not_in_the_file_is_named_with_its_slot() {
    let text = TWO_AXES.replace(
        "<Type ModuleIdent=\"#x402\">",
        "<Type ModuleIdent=\"#x403\">",
    );
    let error = EsiDrive::from_bytes("two_axes.xml", text.as_bytes()).unwrap_err();
    assert!(
        error
            .reason
            .contains("module 00000402h, which is not in this file"),
        "{error}"
    );
    assert!(error.line.is_some());
    let many = TWO_AXES.replace("MaxInstances=\"1\"", "MaxInstances=\"4294967295\"");
    let error = EsiDrive::from_bytes("two_axes.xml", many.as_bytes()).unwrap_err();
    assert!(error.reason.contains("at most 255 slots"), "{error}");
}

#[test]
fn a_device_holds_at_power_up_what_its_file_says_and_has_no_other_object() {
    let mut device = EsiDrive::from_bytes("two_axes.xml", TWO_AXES.as_bytes())
        .unwrap()
        .build();
    assert_eq!(device.description().identity.serial, 0x1234_5678);
    for (object, expected) in [
        ((0x1000, 0), vec![0x92, 0x01, 0x02, 0x00]),
        ((0x1008, 0), b"Two axes".to_vec()),
        ((0x1009, 0), b"B7".to_vec()),
        ((0x100A, 0), b"2.04".to_vec()),
        ((0x1018, 0), vec![4]),
        ((0x1018, 2), vec![0x02, 0x08, 0x00, 0x00]),
        ((0x1018, 4), vec![0x78, 0x56, 0x34, 0x12]),
        ((0x6502, 0), vec![0x21, 0, 0, 0]),
        ((0x6D02, 0), vec![0x01, 0, 0, 0]),
    ] {
        assert_eq!(
            device.read_object(object.0, object.1),
            Ok(expected),
            "{object:X?}"
        );
    }
    // The model has them, the file does not.
    for object in [(0x10F1, 1), (0x607D, 1), (0x60F2, 0), (0x687D, 0)] {
        assert_eq!(
            device.read_object(object.0, object.1),
            Err(Abort::NoObject),
            "{object:X?}"
        );
    }
    assert_eq!(device.read_object(0x1018, 5), Err(Abort::NoSubindex));
    let listed: Vec<u16> = device
        .dictionary()
        .iter()
        .map(|object| object.index)
        .collect();
    assert!(listed.contains(&0x6D02) && !listed.contains(&0x607D) && !listed.contains(&0x10F1));
}

#[test]
fn one_device_of_many_is_chosen_by_product_and_revision() {
    let device = |product: u32, revision: u32, name: &str| {
        format!(
            "<Device><Type ProductCode=\"{product}\" RevisionNo=\"#x{revision:X}\">{name}</Type></Device>"
        )
    };
    let devices = [
        device(7, 1, "old"),
        device(7, 0x20, "new"),
        device(7, 3, "mid"),
        device(8, 1, "other"),
    ];
    let text = format!(
        "<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions><Devices>{}</Devices></Descriptions></EtherCATInfo>",
        devices.concat()
    );
    let name = |product, revision| {
        EsiDrive::read("many.xml", text.as_bytes(), product, revision)
            .map(|drive| drive.description.name)
            .map_err(|error| error.to_string())
    };
    assert_eq!(name(None, None).unwrap(), "old");
    assert_eq!(name(Some(7), None).unwrap(), "new");
    assert_eq!(name(Some(7), Some(3)).unwrap(), "mid");
    assert_eq!(name(Some(8), None).unwrap(), "other");
    assert_eq!(
        name(Some(8), Some(2)).unwrap_err(),
        "many.xml:1: there is no device of product 00000008h and revision 00000002h; the file has \
         00000007h:00000001h, 00000007h:00000020h, 00000007h:00000003h, 00000008h:00000001h"
    );
}

#[test]
fn a_choice_is_a_file_and_numbers_as_people_write_them() {
    let parsed = |text: &str| {
        let Ok(choice) = text.parse::<EsiChoice>();
        let file = choice.file.display().to_string();
        (file, choice.product, choice.revision)
    };
    let of = |file: &str, product, revision| (file.to_owned(), product, revision);
    assert_eq!(parsed("a.xml"), of("a.xml", None, None));
    assert_eq!(parsed("a.xml:42"), of("a.xml", Some(42), None));
    for revision in ["0x1F", "1Fh", "#x1F", "31"] {
        let text = format!("a.xml:2Ah:{revision}");
        assert_eq!(parsed(&text), of("a.xml", Some(42), Some(31)));
    }
    assert_eq!(parsed("c:a.xml"), of("c:a.xml", None, None));
    assert_eq!(parsed("a.xml:0x"), of("a.xml:0x", None, None));
    assert_eq!(
        parsed("a.xml:99999999999"),
        of("a.xml:99999999999", None, None)
    );
}
