#![no_main]

holosonar_fuzz::reader!("s2p");
