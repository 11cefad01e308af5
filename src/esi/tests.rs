use super::*;
use crate::coe::ObjectAddress;
use crate::parameters::Transition;
use crate::pdo_map::{Direction, Entry};
use proptest::prelude::*;

const GENERIC: &str = include_str!("../../sim/esi/generic.xml");

fn file(inside: &str) -> String {
    format!(
        "<EtherCATInfo>\n<Vendor><Id>1</Id></Vendor>\n<Descriptions><Devices><Device><Type ProductCode=\"2\"/>\n{inside}\n</Device></Devices></Descriptions></EtherCATInfo>"
    )
}

fn fault(text: &str) -> EsiError {
    Esi::from_bytes("drive.xml", text.as_bytes()).unwrap_err()
}

#[test]
fn pdos_limits_and_commands_of_a_file_become_a_description() {
    let esi = Esi::from_bytes("generic.xml", GENERIC.as_bytes()).unwrap();
    let device = esi.device(0x4453_0402, 1).unwrap();
    let description = device.description().unwrap();
    assert_eq!(
        (description.vendor, description.product),
        (Some(0), Some(0x4453_0402))
    );
    assert_eq!(description.axes.len(), 1);
    assert_eq!(
        description.axes[0].rx_pdos,
        [0x1600, 0x1601, 0x1602, 0x1603]
    );
    let limits = &description.limits;
    assert_eq!(
        (
            limits.entries_per_pdo,
            limits.output_pdos,
            limits.input_pdos
        ),
        (8, 4, 4)
    );
    assert_eq!((limits.output_bytes, limits.input_bytes), (64, 64));
    let layout = description.default_mapping().unwrap().layout();
    assert_eq!((layout.output_bytes(), layout.input_bytes()), (19, 11));
    assert_eq!(device.clock_modes[0].assign_activate, 0x0300);
    let list = device.start_up_list().unwrap();
    assert_eq!(list.writes.len(), 1);
    assert_eq!(list.writes[0].object, ObjectAddress::new(0x605A, 0));
    assert_eq!(list.writes[0].value.encode(), [2, 0]);
}

#[test]
fn the_synchronisation_types_of_a_description_are_the_defaults_of_the_dictionary() {
    let item = |subindex: u8, name: &str, kind: &str| {
        format!(
            "<SubItem><SubIdx>{subindex}</SubIdx><Name>{name}</Name><Type>{kind}</Type><BitSize>16</BitSize></SubItem>"
        )
    };
    let types = item(0, "Count", "USINT") + &item(1, "Type", "UINT");
    let object = |index: &str, name: &str, value: &str| {
        format!(
            "<Object><Index>#x{index}</Index><Type>D</Type><Info><SubItem><Name>Count</Name></SubItem>\
             <SubItem><Name>{name}</Name><Info>{value}</Info></SubItem></Info></Object>"
        )
    };
    let data = "<DefaultData>0100</DefaultData>";
    for (name, value, got) in [
        ("Type", data, Some(1)),
        ("Type", "<DefaultValue>#x22</DefaultValue>", Some(34)),
        // What is no number of 16 bits, and another subindex' value, are no default.
        ("Type", "<DefaultData>01000000</DefaultData>", None),
        ("Type", "<DefaultData>none</DefaultData>", None),
        ("Type", "<DefaultValue>-1</DefaultValue>", None),
        ("Type", "", None),
        ("Cycle", data, None),
    ] {
        let objects = object("1C32", "Type", data) + &object("1C33", name, value);
        let text = file(&format!(
            "<Profile><Dictionary><DataTypes><DataType><Name>D</Name>{types}</DataType></DataTypes><Objects>{objects}</Objects></Dictionary></Profile>\
             <RxPdo><Index>#x1600</Index><Entry><Index>#x6040</Index><BitLen>16</BitLen></Entry></RxPdo>"
        ));
        let esi = Esi::from_bytes("drive.xml", text.as_bytes()).unwrap();
        let description = esi.devices[0].description().unwrap();
        assert_eq!(description.sync_types, [Some(1), got], "{name} {value}");
    }
}

#[test]
fn texts_of_diagnosis_messages_and_of_603fh_become_those_of_the_drive() {
    let text = file(
        "<Profile><Dictionary><DataTypes>\
         <DataType><Name>DT6085</Name><EnumInfo><Text>other</Text><Enum>1</Enum></EnumInfo></DataType>\
         <DataType><Name>DT603F</Name><BaseType>UINT</BaseType>\
         <EnumInfo><Text>brake resistor missing</Text><Enum>#xFF01</Enum></EnumInfo>\
         <EnumInfo><Text>too large</Text><Enum>#x1FFFF</Enum></EnumInfo></DataType></DataTypes>\
         <Objects><Object><Index>#x6085</Index><Type>DT6085</Type></Object>\
         <Object><Index>#x603F</Index><Type>DT603F</Type></Object></Objects></Dictionary>\
         <DiagMessages><DiagMessage><TextId>#x0102</TextId><MessageText LcId=\"1033\">fan %d stands</MessageText>\
         <MessageText LcId=\"1031\">L\u{fc}fter %d steht</MessageText></DiagMessage>\
         <DiagMessage><TextId>none</TextId><MessageText>lost</MessageText></DiagMessage></DiagMessages></Profile>\
         <RxPdo><Index>#x1600</Index><Entry><Index>#x6040</Index><BitLen>16</BitLen></Entry></RxPdo>",
    );
    let esi = Esi::from_bytes("drive.xml", text.as_bytes()).unwrap();
    let texts = esi.devices[0].description().unwrap().error_texts;
    let codes: Vec<_> = texts.codes.into_iter().collect();
    assert_eq!(codes, [(0xFF01, "brake resistor missing".into())]);
    let diagnosis: Vec<_> = texts.diagnosis.into_iter().collect();
    assert_eq!(diagnosis, [(0x0102, "fan %d stands".into())]);
}

#[test]
fn fixed_mandatory_and_excluded_pdos_and_padding_are_read() {
    let text = file(
        "<RxPdo Fixed=\"1\" Mandatory=\"true\" Sm=\"2\"><Index>#x1701</Index><Exclude>#x1702</Exclude>\
         <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>\
         <Entry><Index>#x0</Index><BitLen>8</BitLen></Entry></RxPdo>",
    );
    let esi = Esi::from_bytes("drive.xml", text.as_bytes()).unwrap();
    let fixed = esi.devices[0].description().unwrap().fixed_pdos;
    assert_eq!(fixed.len(), 1);
    assert!(fixed[0].mandatory);
    assert_eq!(fixed[0].excludes, [0x1702]);
    assert_eq!(
        fixed[0].pdo.entries,
        [Entry::new(0x6040, 0, 16), Entry::padding(8)]
    );
    assert_eq!(esi.devices[0].pdos[0].direction, Direction::Outputs);
}

/// A drive with a slot for each axis, as the files of many drives with two axes have it.
const MODULAR: &str = r##"<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions>
<Devices><Device><Type ProductCode="2"/><Name>Two axes</Name>
  <Profile><Dictionary><DataTypes><DataType><Name>UINT</Name><BitSize>16</BitSize></DataType>
    <DataType><Name>DT1600</Name><SubItem><SubIdx>0</SubIdx><Type>USINT</Type><BitSize>8</BitSize></SubItem>
      <SubItem><Type>A8</Type><BitSize>256</BitSize></SubItem></DataType>
    <DataType><Name>A8</Name><BaseType>UDINT</BaseType><ArrayInfo><LBound>1</LBound><Elements>8</Elements></ArrayInfo></DataType></DataTypes>
    <Objects><Object><Index>#x1000</Index><Type>UDINT</Type><BitSize>32</BitSize></Object></Objects></Dictionary></Profile>
  <Mailbox><CoE PdoConfig="1"/></Mailbox>
  <Slots SlotPdoIncrement="#x40" SlotIndexIncrement="#x800">
    <Slot MinInstances="1" MaxInstances="1"><Name>Axis 1</Name><ModuleIdent>#x11</ModuleIdent><ModuleIdent Default="1">#x12</ModuleIdent></Slot>
    <Slot MinInstances="1" MaxInstances="1"><Name>Axis 2</Name><ModuleIdent>#x12</ModuleIdent><ModuleIdent>#x11</ModuleIdent></Slot>
    <Slot MinInstances="0" MaxInstances="2"><Name>Option</Name><ModuleIdent>#x11</ModuleIdent></Slot>
  </Slots></Device></Devices>
<Modules>
  <Module><Type ModuleIdent="#x11"/><Name>Torque</Name></Module>
  <Module><Type ModuleIdent="#x12"/><Name>Profile Position</Name>
    <RxPdo Sm="2"><Index DependOnSlot="1">#x1600</Index><Exclude DependOnSlot="1">#x1601</Exclude>
      <Entry><Index DependOnSlot="1">#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
      <Entry><Index DependOnSlot="1">#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></RxPdo>
    <TxPdo Sm="3"><Index DependOnSlot="1">#x1A00</Index>
      <Entry><Index DependOnSlot="true">#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
      <Entry><Index DependOnSlot="1">#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
    <Mailbox><CoE><InitCmd><Transition>PS</Transition><Index DependOnSlot="1">#x6098</Index><SubIndex>0</SubIndex><Data>23</Data></InitCmd></CoE></Mailbox>
    <Profile><Dictionary><Objects>
      <Object><Index DependOnSlot="1">#x1600</Index><Name>PDO</Name><Type>DT1600</Type></Object>
      <Object><Index DependOnSlot="1">#x6081</Index><Name>Velocity</Name><Type>UDINT</Type><BitSize>32</BitSize><Flags><Access>rw</Access><PdoMapping>R</PdoMapping></Flags></Object>
    </Objects></Dictionary></Profile></Module>
</Modules></Descriptions></EtherCATInfo>"##;

#[test]
fn the_axes_of_a_modular_drive_are_in_the_modules_of_its_slots() {
    let esi = Esi::from_bytes("modular.xml", MODULAR.as_bytes()).unwrap();
    let device = &esi.devices[0];
    let slots: Vec<_> = device
        .slots
        .iter()
        .map(|slot| (slot.name.as_str(), slot.module))
        .collect();
    // The default, the first of those of which one has to be there, and two that may stay empty.
    let expected = [
        ("Axis 1", Some(0x12)),
        ("Axis 2", Some(0x12)),
        ("Option", None),
        ("Option", None),
    ];
    assert_eq!(slots, expected);
    assert_eq!(device.slots[0].fitting, [0x11, 0x12]);
    let description = device.description().unwrap();
    assert_eq!(description.axes.len(), 2);
    assert_eq!(description.axes[1].rx_pdos, [0x1640]);
    assert_eq!(description.axes[1].tx_pdos, [0x1A40]);
    let second = &device.pdos[1];
    assert_eq!(
        (second.pdo.index, second.excludes.as_slice()),
        (0x1640, &[0x1641][..])
    );
    assert_eq!(second.pdo.entries[0], Entry::new(0x6840, 0, 16));
    let objects: Vec<_> = device.dictionary.iter().map(|entry| entry.object).collect();
    for object in [
        (0x1000, 0),
        (0x1600, 1),
        (0x1640, 1),
        (0x6081, 0),
        (0x6881, 0),
    ] {
        assert!(
            objects.contains(&ObjectAddress::new(object.0, object.1)),
            "{object:X?}"
        );
    }
    let written: Vec<_> = device
        .start_up_list()
        .unwrap()
        .writes
        .iter()
        .map(|write| write.object)
        .collect();
    assert_eq!(
        written,
        [ObjectAddress::new(0x6098, 0), ObjectAddress::new(0x6898, 0)]
    );
    let layout = description.default_mapping().unwrap().layout();
    assert!(layout.output_bytes() >= 12 && layout.input_bytes() >= 12);
}

#[test]
fn slots_that_cannot_be_are_refused() {
    let absent = MODULAR.replace("ModuleIdent=\"#x12\"", "ModuleIdent=\"#x13\"");
    let esi = Esi::from_bytes("modular.xml", absent.as_bytes()).unwrap();
    let error = esi.devices[0].description().unwrap_err();
    assert_eq!(error.slots, 4);
    assert!(error.to_string().contains("slots"), "{error}");
    let many = MODULAR.replace("MaxInstances=\"2\"", "MaxInstances=\"65535\"");
    assert_eq!(fault(&many).fault, EsiFault::TooManySlots);
    let far = MODULAR.replace("#x800", "#xFFFFFFFF");
    assert!(matches!(
        fault(&far).fault,
        EsiFault::Number { max: 65_535, .. }
    ));
}

#[test]
fn a_terminal_without_controlword_is_no_drive() {
    let esi = Esi::from_bytes("terminal.xml", file("<Name>Terminal</Name>").as_bytes()).unwrap();
    let error = esi.devices[0].description().unwrap_err();
    assert!(error.to_string().contains("Terminal"), "{error}");
}

#[test]
fn an_error_names_file_line_and_element() {
    let text = file("<RxPdo><Index>#x16G0</Index></RxPdo>");
    assert_eq!(
        fault(&text).to_string(),
        "drive.xml:4, element Index: expected a number (decimal, or #x and hexadecimal digits) of at most 65535, got `#x16G0`"
    );
    let wrong_direction = fault(&file("<RxPdo><Index>#x1A00</Index></RxPdo>"));
    assert_eq!(wrong_direction.fault, EsiFault::PdoIndex(0x1A00));
    let entry = "<Entry><Index>0</Index><BitLen>1</BitLen></Entry>";
    let long = format!("<TxPdo><Index>#x1A00</Index>{}</TxPdo>", entry.repeat(255));
    assert_eq!(fault(&file(&long)).fault, EsiFault::LongPdo(0x1A00));
    let missing = fault(&file("<TxPdo></TxPdo>"));
    assert_eq!(
        (missing.line, missing.fault),
        (Some(4), EsiFault::Missing("Index"))
    );
    let odd = fault(&file(
        "<Mailbox><CoE><InitCmd><Transition>PS</Transition><Index>1</Index><SubIndex>0</SubIndex><Data>123</Data></InitCmd></CoE></Mailbox>",
    ));
    assert_eq!(odd.fault, EsiFault::Bytes("123".to_owned()));
    assert_eq!(fault("<Html/>").fault, EsiFault::NoEsi);
    let broken = fault("<EtherCATInfo>\n<Vendor>\n</EtherCATInfo>");
    assert!(matches!(
        (broken.line, broken.fault),
        (Some(3), EsiFault::Xml(_))
    ));
    let absent = Esi::load("there/is/no/such.xml").unwrap_err();
    assert!(matches!(absent.fault, EsiFault::Unreadable(_)));
}

#[test]
fn text_in_iso_8859_1_is_read_where_the_file_says_so() {
    let mut bytes = b"<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>".to_vec();
    bytes.extend(b"<EtherCATInfo><Vendor><Id>1</Id><Name>M\xFCller</Name></Vendor></EtherCATInfo>");
    let esi = Esi::from_bytes("drive.xml", &bytes).unwrap();
    assert_eq!(esi.vendor_name, "Müller");
    let bytes = b"<EtherCATInfo>\xFC</EtherCATInfo>";
    let error = Esi::from_bytes("drive.xml", bytes).unwrap_err();
    assert_eq!(error.fault, EsiFault::Encoding);
}

#[test]
fn a_billion_laughs_are_refused_as_a_type_definition() {
    let mut text = String::from("<!DOCTYPE x [<!ENTITY a0 \"lol\">");
    for level in 1..30 {
        text += &format!(
            "<!ENTITY a{level} \"{}\">",
            format!("&a{};", level - 1).repeat(10)
        );
    }
    text += "]><EtherCATInfo>&a29;</EtherCATInfo>";
    assert_eq!(fault(&text).fault, EsiFault::TypeDefinition);
}

#[test]
fn hostile_depth_width_and_size_are_refused_or_read_within_bounds() {
    let deep = "<a>".repeat(500_000);
    assert_eq!(fault(&deep).fault, EsiFault::Truncated);
    let deep = format!("{deep}{}", "</a>".repeat(500_000));
    assert_eq!(fault(&deep).fault, EsiFault::NoEsi);
    let many = format!("<EtherCATInfo>{}</EtherCATInfo>", "<a/>".repeat(4_100_000));
    assert!(matches!(fault(&many).fault, EsiFault::Xml(_)));
    let namespaces: String = (0..1000)
        .map(|n| format!("<a xmlns:n{n}=\"{n}\">"))
        .collect();
    assert_eq!(fault(&namespaces).fault, EsiFault::Excessive("namespaces"));
    let attributes: String = (0..5000).map(|n| format!(" a{n}=\"\"")).collect();
    assert_eq!(
        fault(&format!("<a{attributes}/>")).fault,
        EsiFault::Excessive("attributes of one element")
    );
    let huge = vec![b' '; MOST_BYTES + 1];
    let error = Esi::from_bytes("drive.xml", &huge).unwrap_err();
    assert_eq!(error.fault, EsiFault::TooLarge);
}

#[test]
fn a_short_file_cannot_unfold_into_a_long_dictionary() {
    let types = "<DataTypes><DataType><Name>A</Name><BaseType>UINT</BaseType><ArrayInfo><LBound>1</LBound><Elements>255</Elements></ArrayInfo></DataType>\
                 <DataType><Name>D</Name><SubItem><Type>A</Type></SubItem></DataType></DataTypes>";
    let objects = "<Object><Index>1</Index><Type>D</Type></Object>".repeat(1100);
    let text = file(&format!(
        "<Profile><Dictionary>{types}<Objects>{objects}</Objects></Dictionary></Profile>"
    ));
    assert_eq!(fault(&text).fault, EsiFault::TooManyEntries);
}

#[test]
fn a_truncated_file_is_named_with_the_line_where_it_ends() {
    let text: String = GENERIC
        .lines()
        .take(50)
        .map(|line| format!("{line}\n"))
        .collect();
    let cut = fault(&text);
    assert_eq!(
        (cut.line, cut.fault.clone()),
        (Some(50), EsiFault::Truncated),
        "{cut}"
    );
    let within = fault(&GENERIC[..GENERIC.find("<Sm ").unwrap() + 10]);
    assert!(within.line > Some(50), "{within}");
}

#[test]
fn a_type_definition_is_named_with_its_line_and_a_remedy() {
    let text =
        format!("<?xml version=\"1.0\"?>\n\n<!DOCTYPE EtherCATInfo SYSTEM \"x.dtd\">{GENERIC}");
    assert_eq!(
        fault(&text).to_string(),
        "drive.xml:3: the file has a document type definition, which is not read: take the line that begins with \
         <!DOCTYPE out of it"
    );
}

/// A device with these `InitCmd`s, each a transition and an index.
fn with_commands(commands: &[(&str, &str)]) -> EsiDevice {
    let commands = commands.iter().map(|(attributes, transition)| {
        format!(
            "<InitCmd {attributes}>{transition}<Index>#x2000</Index><SubIndex>1</SubIndex><Data>0{}</Data>\
             <Comment>one</Comment></InitCmd>",
            transition.len() % 10
        )
    });
    let commands: String = commands.collect();
    let text = file(&format!(
        "<Name>Drive</Name><Mailbox><CoE>{commands}</CoE></Mailbox>"
    ));
    let mut esi = Esi::from_bytes("drive.xml", text.as_bytes()).unwrap();
    esi.devices.remove(0)
}

#[test]
fn commands_of_each_transition_are_executed_in_their_order_or_refused_by_name() {
    let at = |name: &str| format!("<Transition>{name}</Transition>");
    let (ip, ps, so) = (at("IP"), at("PS"), at("SO"));
    let both = format!("{ps}{ip}");
    let device = with_commands(&[("", &so), ("", &ps), ("Fixed=\"1\"", &ip), ("", &both)]);
    let list = device.start_up_list().unwrap();
    let transitions: Vec<_> = list.writes.iter().map(|write| write.transition).collect();
    assert_eq!(
        transitions,
        [
            Transition::PreOpToSafeOp,
            Transition::PreOpToSafeOp,
            Transition::SafeOpToOp,
            Transition::PreOpToSafeOp,
            Transition::PreOpToSafeOp,
        ]
    );
    // Those of IP go first: the fixed one, and that of both.
    let firsts: Vec<_> = list
        .writes
        .iter()
        .take(2)
        .map(|write| write.value.encode())
        .collect();
    assert_eq!(firsts, [[ip.len() as u8 % 10], [both.len() as u8 % 10]]);
    let error = with_commands(&[("", &ps), ("Fixed=\"1\"", &at("OS"))])
        .start_up_list()
        .unwrap_err();
    assert_eq!(
        error.to_string(),
        "the InitCmd 2000h:01 (\"one\") of Drive is for the transition OS, and only those of IP, PS and SO are \
         executed; write the object otherwise if the drive needs it: take it out of the file, or of `EsiDevice::init_commands`"
    );
    let error = with_commands(&[("CompleteAccess=\"1\"", &ps)]).start_up_list();
    assert_eq!(error.unwrap_err().why, InitCommandFault::CompleteAccess);
    let none = fault(&file(
        "<Mailbox><CoE><InitCmd><Index>1</Index><SubIndex>0</SubIndex><Data>00</Data></InitCmd></CoE></Mailbox>",
    ));
    assert_eq!(none.fault, EsiFault::Missing("Transition"));
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes: Vec<u8>) {
        let _ = Esi::from_bytes("any", &bytes);
    }

    #[test]
    fn a_file_with_anything_put_anywhere_is_read_or_refused(at in 0usize..20_000, cut in 0usize..40, put in "[<>/#x&;=\"a-zA-Z0-9 ]{0,12}") {
        let start = at % GENERIC.len();
        let end = (start + cut).min(GENERIC.len());
        let text = [&GENERIC.as_bytes()[..start], put.as_bytes(), &GENERIC.as_bytes()[end..]].concat();
        if let Ok(esi) = Esi::from_bytes("changed", &text) {
            for device in &esi.devices {
                if let Ok(description) = device.description() {
                    let _ = description.default_mapping();
                }
                let _ = device.start_up_list();
            }
        }
    }
}

/// A comment may stand in the middle of a value.
#[test]
fn a_value_with_a_comment_in_it_is_read_as_a_whole_or_refused() {
    let text = file(
        "<Mailbox><CoE><InitCmd><Transition>PS</Transition><Index>#x6085</Index><SubIndex>0</SubIndex>\
         <Data>4042<!-- 1 000 000 counts/s2 -->0F00</Data></InitCmd></CoE></Mailbox>",
    );
    if let Ok(esi) = Esi::from_bytes("drive.xml", text.as_bytes()) {
        assert_eq!(esi.devices[0].init_commands[0].data, [0x40, 0x42, 0x0F, 0]);
    }
}

/// Or of an index.
#[test]
fn an_index_with_a_comment_in_it_is_read_as_a_whole_or_refused() {
    let text = file(
        "<Mailbox><CoE><InitCmd><Transition>PS</Transition><Index>#x60<!-- window -->65</Index><SubIndex>0</SubIndex>\
         <Data>40420F00</Data></InitCmd></CoE></Mailbox>",
    );
    if let Ok(esi) = Esi::from_bytes("drive.xml", text.as_bytes()) {
        assert_eq!(
            esi.devices[0].init_commands[0].object,
            ObjectAddress::new(0x6065, 0)
        );
    }
}

/// One RxPDO with room for eight objects, and a second one (for a touch probe, say) with room for one alone. One RxPDO can be
/// assigned, and up to eight TxPDOs.
#[test]
fn each_pdo_and_each_direction_has_limits_of_its_own() {
    let kind = |name: &str, places: u8| {
        let items: String = (0..=places)
            .map(|subindex| format!("<SubItem><SubIdx>{subindex}</SubIdx><Type>UDINT</Type><BitSize>32</BitSize></SubItem>"))
            .collect();
        format!("<DataType><Name>{name}</Name>{items}</DataType>")
    };
    let object = |index: &str, kind: &str| {
        format!("<Object><Index>#x{index}</Index><Type>{kind}</Type></Object>")
    };
    let types = kind("Large", 8) + &kind("Small", 1);
    let assigned = object("1C12", "Small") + &object("1C13", "Large");
    let pdos = object("1600", "Large") + &object("1601", "Small") + &object("1A00", "Large");
    let entries = |objects: &[(u16, u8)]| -> String {
        let entry = |(index, bits): &(u16, u8)| {
            format!("<Entry><Index>#x{index:04X}</Index><BitLen>{bits}</BitLen></Entry>")
        };
        objects.iter().map(entry).collect()
    };
    let outputs = entries(&[
        (0x6040, 16),
        (0x6060, 8),
        (0x607A, 32),
        (0x6081, 32),
        (0x6083, 32),
        (0x6084, 32),
    ]);
    let inputs = entries(&[(0x6041, 16), (0x6061, 8), (0x6064, 32), (0x606C, 32)]);
    let text = file(&format!(
        "<Profile><Dictionary><DataTypes>{types}</DataTypes><Objects>{pdos}{assigned}</Objects></Dictionary></Profile>\
         <RxPdo Sm=\"2\"><Index>#x1600</Index>{outputs}</RxPdo>\
         <RxPdo><Index>#x1601</Index>{}</RxPdo>\
         <TxPdo Sm=\"3\"><Index>#x1A00</Index>{inputs}</TxPdo>\
         <Mailbox><CoE PdoConfig=\"1\"/></Mailbox>",
        entries(&[(0x60B8, 16)])
    ));
    let esi = Esi::from_bytes("drive.xml", text.as_bytes()).unwrap();
    let description = esi.devices[0].description().unwrap();
    let limits = &description.limits;
    assert_eq!((limits.output_pdos, limits.input_pdos), (1, 8));
    let mapping = description.default_mapping();
    let layout = mapping.map(|mapping| mapping.layout());
    let bytes = layout.map(|layout| (layout.output_bytes(), layout.input_bytes()));
    assert_eq!(bytes, Ok((19, 11)), "{limits:?}");
}

#[test]
fn the_register_of_its_identification_is_that_of_the_file() {
    for (inside, register) in [
        (
            "<Info><IdentificationAdo>#x0f1a</IdentificationAdo></Info>",
            Some(0x0F1A),
        ),
        ("<Info/>", None),
        ("", None),
    ] {
        let esi = Esi::from_bytes("drive.xml", file(inside).as_bytes()).unwrap();
        let device = esi.device(2, 0).unwrap();
        assert_eq!(device.identification_ado, register);
    }
}
