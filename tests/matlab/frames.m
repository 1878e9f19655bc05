% Reads messages in hexadecimal, a line each, and prints their frames; then frames, and prints what is in them.
[bits, zeros_crc] = Heli.crcTables(488);
function bytes = hex(line)
  bytes = uint8(hex2dec(reshape(line, 2, [])'))';
end
for line = strsplit(fileread('messages.txt'), "\n")
  if ~isempty(line{1})
    body = hex(line{1});
    crc = typecast(Heli.crc(body, bits, zeros_crc), 'uint8');
    frame = Heli.encode([body, crc]);
    assert(isequal(Heli.decode(frame), [body, crc]));
    printf('%s\n', lower(sprintf('%02X', [frame, 0])));
  end
end
