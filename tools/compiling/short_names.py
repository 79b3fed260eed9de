"""Names that cost nothing on a board: MicroPython has them in its ROM."""

# Of MicroPython's static_qstr_list (py/makeqstrdata.py), part of the .mpy format 6. Not those
# that it asks an object for by itself: send, throw, close, read, write, keys, args, value; nor
# those of errors, which one would misread in a message.
SHORT = (
    "any id dir key map pop pow sep sum zip all chr ord abs end get int len set str add dict eval "
    "exec find hash iter join list next sort lower upper range print round index clear count copy "
    "bool bytes items little encode decode extend format globals insert isalpha isdigit islower "
    "isspace isupper locals lstrip rstrip strip split rsplit replace remove repr reverse rfind "
    "rindex popitem setdefault sorted update values tuple object type super property startswith "
    "endswith callable classmethod staticmethod divmod from_bytes to_bytes getattr hasattr "
    "setattr isinstance issubclass bytearray bytecode builtins append "
    # Not static, but in the ROM of every port with the usual modules: they are searched for at
    # start, and on a port without them cost what they are long.
    "acos asin atan ceil cosh erf erfc fabs fmod ldexp log2 modf sinh tanh trunc acosh asinh "
    "atanh expm1 gamma isinf isnan floor log10 lgamma degrees isclose isfinite radians deque "
    "popleft appendleft heapify heappop heappush namedtuple sha1 sha256 digest hexlify unhexlify "
    "sizeof calcsize pack_into unpack_from addressof pixel hline vline ellipse seed choice "
    "randint uniform randrange getrandbits getcwd ilistdir rmdir statvfs umount gmtime mktime "
    "localtime getter deleter discard union issubset issuperset isdisjoint difference readlines "
    "search match groups compile dumps loads scroll blit fill_rect framebuf polar factorial "
    "copysign cmath frozenset complex default a2b_base64 b2a_base64 md5 baudrate polarity "
    "firstbit mosi miso scl sda readfrom writeto readfrom_mem writeto_mem writevto memaddr "
    "write_readinto readbit writebit readbyte writebyte crc8 uname sysname nodename mkdir chdir "
    "UINT8 INT8 UINT16 INT16 UINT32 INT32 UINT64 INT64 BFUINT8 BFINT8 BFUINT16 BFINT16 "
    "BFUINT32 BFINT32 BF_POS BF_LEN FLOAT32 FLOAT64 ARRAY NATIVE LITTLE_ENDIAN BIG_ENDIAN "
    "EPERM EBADF EACCES EEXIST ENODEV EISDIR EOPNOTSUPP EADDRINUSE ECONNABORTED ECONNRESET "
    "ENOBUFS ENOTCONN ETIMEDOUT ECONNREFUSED EHOSTUNREACH EALREADY EINPROGRESS OrderedDict "
    "MONO_VLSB MONO_HLSB RGB565 GS8 heap_unlock qstr_info lightsleep deepsleep time_pulse_us "
    "bitstream isenabled aes encrypt decrypt poly GS4_HMSB GS2_HMSB MVLSB readfrom_into "
    "readfrom_mem_into unique_id bootloader soft_reset mem16 mem8 dht_readinto disable_irq "
    "RTC SoftSPI SoftI2C Signal WDT_RESET PWRON_RESET reset_cause modify POLLHUP POLLERR "
    "opt_level VOID PTR"
).split()
