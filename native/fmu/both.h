/* Functions that both versions of FMI have, but for their names: included by fmi2.c and fmi3.c, after FMI(name, ...), which
   opens one, and the types Boolean, Text and Byte. STATE : how the version spells a state in names; READ_STATE : the
   function that reads one. */

#define STATE_FUNCTION(before, after) NAME_OF(before, STATE, after)
#define NAME_OF(before, state, after) JOINED(before, state, after)
#define JOINED(before, state, after) before##state##after

FMI(SetDebugLogging, instance *i, Boolean on, size_t n, const Text categories[])
{
    NEEDS_INSTANCE;
    return set_logging(i, on, n, categories);
}

FMI(ExitInitializationMode, instance *i)
{
    NEEDS_INSTANCE;
    OR_REFUSED(component_leave(i->c), STATUS_ERROR);
}

FMI(Terminate, instance *i)
{
    NEEDS_INSTANCE;
    i->c->numbers[STATE_OF] = TERMINATED;
    return STATUS_OK;
}

FMI(Reset, instance *i)
{
    NEEDS_INSTANCE;
    component_reset(i->c);
    i->failed = 0;
    return STATUS_OK;
}

FMI(STATE_FUNCTION(Get, ), instance *i, void **state)
{
    NEEDS_INSTANCE;
    return state_get(i, state);
}

FMI(STATE_FUNCTION(Set, ), instance *i, void *state)
{
    NEEDS_INSTANCE;
    return state_set(i, state);
}

FMI(STATE_FUNCTION(Free, ), instance *i, void **state)
{
    NEEDS_INSTANCE;
    return state_free(i, state);
}

FMI(STATE_FUNCTION(Serialized, Size), instance *i, void *state, size_t *size)
{
    NEEDS_INSTANCE;
    return state_size(i, state, size);
}

FMI(STATE_FUNCTION(Serialize, ), instance *i, void *state, Byte bytes[], size_t size)
{
    NEEDS_INSTANCE;
    return state_write(i, state, (char *)bytes, size);
}

FMI(READ_STATE, instance *i, const Byte bytes[], size_t size, void **state)
{
    NEEDS_INSTANCE;
    return state_read(i, (const char *)bytes, size, state);
}
