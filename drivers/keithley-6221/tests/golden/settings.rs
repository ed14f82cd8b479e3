//! Settings that are written and read back.

use super::talk::Talk;

const NONE: &str = "0,\"No error\"";

fn conversation(lines: &[(&str, &str)]) {
    let mut talk = Talk::new(500.0);
    talk.hold(lines).hold(&[("SYST:ERR?", NONE)]);
}

#[test]
fn section_4_sweep_settings() {
    conversation(&[
        ("SOUR:DEL 0.25;DEL?", "2.500000E-01"),
        ("SOUR:DEL? MIN;DEL? MAX", "1.000000E-03;1.000000E+06"),
        ("SOUR:SWE:SPAC LOG;SPAC?", "LOG"),
        ("SOUR:SWE:SPAC LIST;SPAC?", "LIST"),
        (
            "SOUR:SWE:POIN 65535;POIN?;POIN? MIN;POIN? MAX",
            "65535;1;65535",
        ),
        ("SOUR:SWE:COUN 9999;COUN?", "9999"),
        ("SOUR:SWE:COUN INF;COUN?", "9.900000E+37"),
        ("SOUR:SWE:RANG AUTO;RANG?", "AUTO"),
        ("SOUR:SWE:RANG FIXED;RANG?", "FIX"),
        ("SOUR:SWE:CAB ON;CAB?", "1"),
        ("SOUR:CURR:STAR -1e-3;STOP 3e-3;STEP 1e-3", "-"),
        (
            "SOUR:CURR:STAR?;STOP?;STEP?",
            "-1.000000E-03;3.000000E-03;1.000000E-03",
        ),
        ("SOUR:CURR:CENT?;SPAN?", "1.000000E-03;4.000000E-03"),
        ("SOUR:SWE:SPAC LIN;POIN?", "5"),
        (
            "SOUR:CURR:CENT 0;SPAN 2e-3;STAR?;STOP?",
            "-1.000000E-03;1.000000E-03",
        ),
        ("SOUR:SWE:POIN 3;:SOUR:CURR:STEP?", "1.000000E-03"),
    ]);
}

#[test]
fn section_4_lists() {
    conversation(&[
        (
            "SOUR:LIST:CURR 1e-3,-2e-3,0.105;CURR?",
            "1.000000E-03,-2.000000E-03,1.050000E-01",
        ),
        ("SOUR:LIST:CURR:POIN?", "3"),
        ("SOUR:LIST:CURR:APP 4e-3,5e-3", "-"),
        ("SOUR:LIST:CURR:POIN?", "5"),
        ("SOUR:LIST:DEL 0.1,0.2;DEL?", "1.000000E-01,2.000000E-01"),
        ("SOUR:LIST:COMP 10,105;COMP?", "1.000000E+01,1.050000E+02"),
    ]);
}

#[test]
fn section_4_wave_settings() {
    conversation(&[
        ("SOUR:WAVE:FUNC?", "SIN"),
        ("SOUR:WAVE:FUNC SQU;FUNC?", "SQU"),
        ("SOUR:WAVE:FUNC RAMP;FUNC?", "RAMP"),
        ("SOUR:WAVE:FUNC ARB0;FUNC?", "ARB0"),
        ("SOUR:WAVE:FUNC ARB4;FUNC?", "ARB4"),
        (
            "SOUR:WAVE:FREQ 1e5;FREQ?;FREQ? MIN",
            "1.000000E+05;1.000000E-03",
        ),
        (
            "SOUR:WAVE:AMPL 2e-12;AMPL?;AMPL? MAX",
            "2.000000E-12;1.050000E-01",
        ),
        ("SOUR:WAVE:OFFS -1e-3;OFFS?", "-1.000000E-03"),
        ("SOUR:WAVE:DCYC 25;DCYC?", "2.500000E+01"),
        ("SOUR:WAVE:DUR:TIME?", "9.900000E+37"),
        ("SOUR:WAVE:DUR:TIME 100e-9;TIME?", "1.000000E-07"),
        (
            "SOUR:WAVE:DUR:CYCL 100;CYCL?;TIME?",
            "1.000000E+02;1.000000E-03",
        ),
        ("SOUR:WAVE:DUR:TIME INF;TIME?", "9.900000E+37"),
        ("SOUR:WAVE:RANG FIX;RANG?", "FIX"),
        ("SOUR:WAVE:PMAR 90;PMAR?", "9.000000E+01"),
        ("SOUR:WAVE:PMAR:STAT ON;STAT?;OLIN 6;OLIN?", "1;6"),
        (
            "SOUR:WAVE:ARB:DATA -1,0,0.5,1;DATA?",
            "-1.000000E+00,0.000000E+00,5.000000E-01,1.000000E+00",
        ),
        ("SOUR:WAVE:ARB:COPY 2;:SOUR:WAVE:ARB:POIN?", "4"),
    ]);
}

#[test]
fn section_4_arbitrary_wave_has_at_most_100_points() {
    let mut talk = Talk::new(500.0);
    let points = vec!["0.5"; 101].join(",");
    talk.say(&format!("SOUR:WAVE:ARB:DATA {points}"));
    talk.hold(&[("SYST:ERR?", "-223,\"Too much data\"")]);
}

#[test]
fn section_4_delta_modes_without_a_2182a() {
    let missing = "-241,\"Hardware missing\"";
    let stale = "-230,\"Data corrupt or stale\"";
    conversation(&[
        ("SOUR:DELT:NVPR?;:SOUR:DCON:NVPR?;:SOUR:PDEL:NVPR?", "0;0;0"),
        // HIGH also sets LOW to its negative.
        ("SOUR:DELT:HIGH 10e-3;LOW?", "-1.000000E-02"),
        (
            "SOUR:DELT:LOW -1e-3;HIGH?;LOW?",
            "1.000000E-02;-1.000000E-03",
        ),
        (
            "SOUR:DELT:DEL 0.1;DEL?;COUN 65536;COUN?",
            "1.000000E-01;65536",
        ),
        (
            "SOUR:DELT:COUN INF;COUN?;CAB ON;CAB?;CSW ON;CSW?",
            "9.900000E+37;1;1",
        ),
        ("SOUR:DELT:ARM;ARM?", "0"),
        ("SYST:ERR?", missing),
        ("SOUR:DCON:STAR -1e-3;STAR?;ARM", "-1.000000E-03"),
        ("SYST:ERR?", missing),
        ("SOUR:PDEL:WIDT 1e-3;WIDT?;ARM", "1.000000E-03"),
        ("SYST:ERR?", missing),
        ("SENS:DATA?", "-"),
        ("SYST:ERR?", stale),
    ]);
}

#[test]
fn section_4_arm_and_trigger_layers() {
    conversation(&[
        ("ARM:SOUR?;:TRIG:SOUR?", "IMM;IMM"),
        ("ARM:SOUR TIM;SOUR?;TIM 2;TIM?", "TIM;2.000000E+00"),
        (
            "ARM:SOUR BST;SOUR?;:ARM:SOUR PST;SOUR?;:ARM:SOUR NST;SOUR?",
            "BST;PST;NST",
        ),
        ("ARM:SOUR MAN;SOUR?;:ARM:SOUR BUS;SOUR?", "MAN;BUS"),
        ("ARM:SOUR TLIN;SOUR?;ILIN 4;ILIN?", "TLIN;4"),
        ("TRIG:SOUR TLIN;SOUR?;ILIN 4;ILIN?;OLIN 3;OLIN?", "TLIN;4;3"),
        (
            "TRIG:OUTP DEL;OUTP?;:TRIG:OUTP SOUR;OUTP?;:TRIG:OUTP NONE;OUTP?",
            "DEL;SOUR;NONE",
        ),
        // BUS is an error in the trigger layer.
        ("TRIG:SOUR BUS;SOUR?", "TLIN"),
        ("SYST:ERR?", "-224,\"Illegal parameter value\""),
    ]);
}

#[test]
fn section_4_buffer_display_units_and_interfaces() {
    conversation(&[
        ("TRAC:POIN 64;POIN?", "64"),
        ("TRAC:CLE;FEED SENSE;FEED?;FEED:CONT NEXT", "SENS"),
        ("TRAC:FEED:CONT?", "NEXT"),
        ("TRAC:POIN:ACT?;:TRAC:ACT?", "0;0"),
        ("TRAC:DATA?", "-"),
        ("SYST:ERR?", "-230,\"Data corrupt or stale\""),
        ("FORM:DATA ASCII;DATA?;ELEM?", "ASC;READ,TST"),
        ("FORM:ELEM READ,SOUR,COMP;ELEM?", "READ,SOUR,COMP"),
        ("FORM:ELEM ALL;ELEM?", "READ,TST,UNIT,RNUM,SOUR,COMP,AVOL"),
        (
            "UNIT:VOLT:DC OHMS;DC?;:UNIT:VOLT SIEM;DC?;:UNIT?",
            "OHMS;SIEM;SIEM",
        ),
        ("DISP:ENAB OFF;ENAB?", "0"),
        ("SYST:BEEP 440,0.1", "-"),
        ("SYST:COMM:ETH:ADDR \"10.0.0.7\";ADDR?", "\"10.0.0.7\""),
        (
            "SYST:COMM:ETH:MASK?;GAT?;DHCP?",
            "\"255.255.255.0\";\"192.168.0.1\";0",
        ),
        (
            "SYST:COMM:SER:BAUD 115200;BAUD?;TERM CRLF;TERM?;PACE XON;PACE?",
            "115200;CRLF;XON",
        ),
    ]);
}

#[test]
fn section_1_the_serial_port_has_the_usual_rates() {
    conversation(&[
        (
            "SYST:COMM:SER:BAUD?;BAUD 300;BAUD?;BAUD 301;BAUD?",
            "9600;300;300",
        ),
        ("SYST:ERR?", "-224,\"Illegal parameter value\""),
        ("SYST:COMM:SER:CONT:RTS IBF;RTS?", "IBF"),
        ("SYST:COMM:RWL ON;RWL?;LOC;REM", "1"),
        ("SYST:COMM:SEL SER;SEL?;SEL ETH;SEL?", "SER;ETH"),
    ]);
}

#[test]
fn section_4_memories() {
    conversation(&[
        (
            "SOUR:CURR:RANG 2e-3;:SOUR:CURR 1e-3;CURR:COMP 20;:SOUR:WAVE:FREQ 50;:OUTP 1;*SAV 3",
            "-",
        ),
        (
            "*RST;:SOUR:CURR?;CURR:COMP?;:SOUR:WAVE:FREQ?",
            "0.000000E+00;1.000000E+01;1.000000E+03",
        ),
        (
            "*RCL 3;:SOUR:CURR?;CURR:COMP?;RANG?",
            "1.000000E-03;2.000000E+01;2.000000E-03",
        ),
        ("SOUR:WAVE:FREQ?;:OUTP?", "5.000000E+01;0"),
        ("*RCL 0;:SOUR:CURR?", "0.000000E+00"),
        ("*SAV 5", "-"),
        ("SYST:ERR?", "-222,\"Parameter data out of range\""),
        // The network port keeps its address.
        ("SYST:COMM:ETH:DHCP 1;*RST;DHCP?", "1"),
    ]);
}

#[test]
fn section_4_commands_that_public_drivers_send() {
    conversation(&[
        (
            "FORM:SREG HEX;SREG?;*ESE 60;*ESE?;:STAT:OPER:COND?",
            "HEX;#H3C;#H400",
        ),
        (
            "FORM:SREG BIN;:STAT:MEAS:ENAB 8;ENAB?;:FORM:SREG OCT;*ESE?",
            "#B1000;#Q74",
        ),
        ("FORM:SREG ASC;*ESE?", "60"),
        (
            "CALC1:FORM MXB;FORM?;KMAT:MMF 2;MBF 0.5;MMF?;MBF?",
            "MXB;2.000000E+00;5.000000E-01",
        ),
        (
            "CALC:STAT ON;STAT?;:CALC2:FORM SDEV;FORM?;STAT?",
            "1;SDEV;0",
        ),
        ("CALC:DATA?;:SYST:ERR?", "-230,\"Data corrupt or stale\""),
        ("CALC2:IMM;DATA?", "-"),
        (
            "SYST:ERR?;:SYST:ERR?",
            "-230,\"Data corrupt or stale\";-230,\"Data corrupt or stale\"",
        ),
        (
            "DISP:WIND1:TEXT:DATA 'up';STAT ON;STAT?;:DISP:TEXT?;:DISP:WIND2:TEXT?",
            "1;\"up\";\"\"",
        ),
        ("DISP:WIND:ATTR?", "\"00\""),
        (
            "DISP:WIND1:TEXT 'one character too many';:SYST:ERR?",
            "-223,\"Too much data\"",
        ),
        (
            "SOUR:WAVE:EXTR:ILIN 0;ILIN?;IGN ON;IGN?;IVAL -1;IVAL?;:SOUR:WAVE:EXTR?",
            "0;1;-1.000000E+00;0",
        ),
        (
            "SOUR:WAVE:EXTR ON;:SOUR:WAVE:ARM;:SYST:ERR?",
            "-221,\"Settings conflict\"",
        ),
        (
            "SOUR:WAVE:EXTR OFF;:SOUR:WAVE:ARM;:SYST:ERR?",
            "0,\"No error\"",
        ),
        ("STAT:QUE:ENAB?;DIS?", "(-440:+958);()"),
        (
            "STAT:QUE:DIS (-113,-230:-220);DIS?;ENAB?",
            "(-230:-220,-113);(-440:-231,-219:-114,-112:+958)",
        ),
        // The error sets its event bit and is not queued.
        (
            "*ESR?;:SOUR:CURR 99;:SYST:ERR?;*ESR?",
            "144;0,\"No error\";16",
        ),
        (
            "STAT:QUE:ENAB (-440:+900);:SOUR:CURR 99;:SYST:ERR?",
            "-222,\"Parameter data out of range\"",
        ),
        (
            "STAT:QUE:ENAB (one);:SYST:ERR?",
            "-171,\"Invalid expression\"",
        ),
        ("CALC3:LIM:STAT ON;STAT?;FAIL?", "1;0"),
        ("SYST:KEY 1", "-"),
        ("SYST:ERR?", "-113,\"Undefined header\""),
    ]);
}
